// A canvas with a scene, a camera that orbits about its middle, and named views of the body.

import {
  MathUtils, PerspectiveCamera, Plane, Raycaster, Scene, Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { make } from "./controls.js";

const TURN = 0.15; // rad by an arrow key
const CLICK = 5; // pixels that a click may move
const HALF_VIEW = 15; // degrees that the camera sees on either side
const COARSE = 0.33; // of the pixels across, where a processor draws and something moves
const DAMPED = 0.1; // (pixels/mm)²
const STEPS = 50; // towards the centre of the smallest sphere

// A sphere about points (x, y, z, x, …) that is hardly larger than the smallest: the centre goes
// towards the point that is furthest away, by smaller and smaller steps (Badoiu and Clarkson 2003).
export function enclosing(points) {
  const centre = new Vector3().fromArray(points);
  const point = new Vector3();
  const furthest = new Vector3();
  let reach = 0;
  for (let step = 0; step <= STEPS; step += 1) {
    reach = 0;
    for (let k = 0; k < points.length; k += 3) {
      const away = point.fromArray(points, k).distanceTo(centre);
      if (away > reach) {
        reach = away;
        furthest.copy(point);
      }
    }
    if (step < STEPS) centre.lerp(furthest, 1 / (step + 2));
  }
  return { centre, reach };
}

// Where the eye is, and what is up on the screen, in each view. LAO 45° and RAO 30° turn about the
// body's long axis to the patient's left and right; `base` looks along the axis of the ventricles.
function namedViews(up, front, base) {
  const left = new Vector3().crossVectors(up, front);
  const about = (degrees) => front.clone().applyAxisAngle(up, MathUtils.degToRad(degrees));
  const back = front.clone().negate();
  return {
    AP: [front, up],
    "LAO 45°": [about(45), up],
    "RAO 30°": [about(-30), up],
    "left lateral": [left, up],
    inferior: [up.clone().negate(), front],
    base: [base, back.addScaledVector(base, -back.dot(base)).normalize()],
  };
}

// Whether a processor draws, which smooth edges take half of the time of.
function withoutCard() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const said = gl.getExtension("WEBGL_debug_renderer_info");
  const name = said ? gl.getParameter(said.UNMASKED_RENDERER_WEBGL) : "";
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

export class Stage {
  // `up` and `front` are unit vectors of the body, `base` points from apex to base; `points` is a
  // Float32Array (x, y, z, x, …) of what the picture has to hold.
  constructor(canvas, picture, { up, front, base = up, points }) {
    this.canvas = canvas;
    this.picture = picture;
    this.slow = withoutCard();
    this.share = 1; // of the pixels across
    this.renderer = new WebGLRenderer({
      canvas, antialias: !this.slow, alpha: true, preserveDrawingBuffer: true,
    });
    this.renderer.localClippingEnabled = true;
    this.scene = new Scene();
    this.up = new Vector3(...up);
    this.views = namedViews(...[up, front, base].map((axis) => new Vector3(...axis)));
    // Cuts away what is nearer to the eye, of materials that have it among their clippingPlanes
    this.clip = new Plane();
    this.cut = 0; // share of the depth that is cut away
    this.onClick = null; // (ray) => {}
    this.onPress = null; // (x, y) => {move(dx, dy), end()} of what is grasped there, or null
    this.onTurn = null; // () => {}, after the camera moved
    this.onRender = null; // () => {}, after the picture was drawn
    this.camera = new PerspectiveCamera(2 * HALF_VIEW);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.enablePan = false;
    this.orbit.addEventListener("change", () => this.turned());
    this.hold(points);
    this.view("AP");
    this.listen();
  }

  // Shows what holds these points, from where the camera looks.
  hold(points) {
    const { centre, reach } = enclosing(points);
    const from = this.camera.position.clone().sub(this.orbit.target).normalize();
    this.centre = centre;
    this.reach = reach;
    this.distance = reach / Math.sin(MathUtils.degToRad(HALF_VIEW));
    Object.assign(this.camera, { near: reach / 50, far: reach * 20 });
    this.camera.updateProjectionMatrix();
    Object.assign(this.orbit, { minDistance: reach, maxDistance: 8 * reach });
    this.orbit.target.copy(centre);
    this.camera.position.copy(centre).addScaledVector(from, this.distance);
    this.orbit.update();
    this.turned();
  }

  // Looks at the middle of other points, from the same side and as far away.
  centreOn(points) {
    const { centre } = enclosing(points);
    this.camera.position.add(centre).sub(this.centre);
    this.centre = centre;
    this.orbit.target.copy(centre);
    this.following = true; // other pictures do so themselves
    this.orbit.update();
    this.following = false;
    this.draw();
  }

  listen() {
    const when = (target, kind, heard) =>
      target.addEventListener(kind, heard, { signal: this.ended.signal });
    this.ended = new AbortController();
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.picture);
    this.pressed = null;
    when(this.canvas, "pointerdown", (event) => (this.pressed = [event.clientX, event.clientY]));
    this.picture.addEventListener("pointerdown", (event) => this.press(event), {
      capture: true, signal: this.ended.signal, // before the camera takes it
    });
    when(this.canvas, "click", (event) => {
      const [x, y] = this.pressed ?? [event.clientX, event.clientY];
      if (Math.hypot(event.clientX - x, event.clientY - y) >= CLICK) return;
      this.onClick?.(this.ray(event.clientX, event.clientY));
    });
    when(this.canvas, "keydown", (event) => this.turnByKey(event));
    when(window, "beforeprint", () => this.toImage());
    when(window, "afterprint", () => this.toCanvas());
    when(matchMedia("print"), "change", (event) =>
      event.matches ? this.toImage() : this.toCanvas(),
    );
  }

  add(object) {
    this.scene.add(object);
    this.draw();
  }

  remove(object) {
    this.scene.remove(object);
    this.draw();
  }

  view(name) {
    const [from, up] = this.views[name];
    this.camera.up.copy(up);
    this.camera.position.copy(this.centre).addScaledVector(from, this.distance);
    this.camera.lookAt(this.centre);
    this.orbit.update();
    this.turned();
  }

  // Looks as another stage does.
  follow(other) {
    this.following = true;
    this.camera.up.copy(other.camera.up);
    this.camera.position.copy(other.camera.position).sub(other.centre).add(this.centre);
    this.camera.lookAt(this.centre);
    this.orbit.update();
    this.following = false;
    this.draw();
  }

  turned() {
    this.draw();
    if (!this.following) this.onTurn?.();
  }

  turnByKey(event) {
    const [across, along] = {
      ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, -TURN], ArrowDown: [0, TURN],
    }[event.key] ?? [0, 0];
    if (!across && !along) return;
    event.preventDefault();
    const away = this.camera.position.clone().sub(this.centre);
    const right = new Vector3().crossVectors(this.camera.up, away).normalize();
    away.applyAxisAngle(this.camera.up, across).applyAxisAngle(right, along);
    this.camera.position.copy(this.centre).add(away);
    this.orbit.update();
    this.turned();
  }

  // Moves what is grasped with the pointer, until it is let go.
  press(event) {
    const { clientX, clientY, pointerId } = event;
    const grasped = event.button === 0 && this.onPress?.(clientX, clientY);
    if (!grasped) return;
    event.stopPropagation();
    event.preventDefault();
    this.pressed = [-Infinity, -Infinity]; // its end is no click
    this.canvas.setPointerCapture(pointerId);
    const held = new AbortController();
    const when = (kind, heard) => this.canvas.addEventListener(
      kind, (now) => now.pointerId === pointerId && heard(now), { signal: held.signal });
    when("pointermove", (now) => grasped.move(now.clientX - clientX, now.clientY - clientY));
    when("lostpointercapture", () => {
      held.abort();
      grasped.end();
    });
  }

  // Where a place is in the window (pixels).
  onScreen(place) {
    const area = this.canvas.getBoundingClientRect();
    const { x, y } = place.clone().project(this.camera);
    return new Vector2(area.left + ((x + 1) / 2) * area.width, area.top + ((1 - y) / 2) * area.height);
  }

  // A function that gives how far (mm) to the patient's left and up a place of the skin moves, so
  // that it follows the pointer (pixels) as well as it can.
  alongSkin(place) {
    const outwards = place.clone().sub(this.centre).normalize();
    const up = this.up.clone().addScaledVector(outwards, -this.up.dot(outwards)).normalize();
    const here = this.onScreen(place);
    const [l, u] = [new Vector3().crossVectors(up, outwards), up].map((way) =>
      this.onScreen(place.clone().add(way)).sub(here));
    // least squares, damped: what moves towards the eye is hardly seen to move
    const [ll, lu, uu] = [l.dot(l) + DAMPED, l.dot(u), u.dot(u) + DAMPED];
    const whole = ll * uu - lu * lu;
    return (dx, dy) => {
      const [a, b] = [l, u].map((way) => way.x * dx + way.y * dy);
      return [(uu * a - lu * b) / whole, (ll * b - lu * a) / whole];
    };
  }

  // Draws fewer pixels while something moves, if that is what takes the time.
  coarse(yes) {
    const share = yes && this.slow ? COARSE : 1;
    if (share === this.share) return;
    this.share = share;
    this.resize();
  }

  // From the eye through a place of the window.
  ray(x, y) {
    const area = this.canvas.getBoundingClientRect();
    const ray = new Raycaster();
    ray.setFromCamera(
      new Vector2((2 * (x - area.left)) / area.width - 1, 1 - (2 * (y - area.top)) / area.height),
      this.camera,
    );
    return ray;
  }

  resize() {
    const width = this.picture.clientWidth;
    const height = this.picture.clientHeight;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.share * Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // the sphere fits the shorter side
    const half = Math.tan(MathUtils.degToRad(HALF_VIEW)) / Math.min(this.camera.aspect, 1);
    this.camera.fov = 2 * MathUtils.radToDeg(Math.atan(half));
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  // Renders with the next frame, however often it is called.
  draw() {
    this.pending ??= requestAnimationFrame(() => this.render());
  }

  render() {
    this.pending = null;
    this.setClip();
    this.renderer.render(this.scene, this.camera);
    this.onRender?.();
  }

  setClip() {
    const away = this.camera.position.clone().sub(this.centre).normalize();
    const depth = this.reach * (1 - 2 * this.cut);
    const place = this.centre.clone().addScaledVector(away, depth);
    this.clip.setFromNormalAndCoplanarPoint(away.negate(), place);
  }

  isCut(place) {
    return this.cut > 0 && this.clip.distanceToPoint(place) < 0;
  }

  toImage() {
    if (this.image) return;
    this.render();
    this.image = make("img", { src: this.canvas.toDataURL(), alt: "the heart as it was turned" });
    this.canvas.replaceWith(this.image);
  }

  toCanvas() {
    if (!this.image) return;
    this.image.replaceWith(this.canvas);
    this.image = null;
    this.resize();
  }

  dispose() {
    cancelAnimationFrame(this.pending);
    this.ended.abort();
    this.observer.disconnect();
    this.orbit.dispose();
    this.renderer.dispose();
  }
}
