// A heart that can be turned: activations of scenarios on its surface, the front over time, trees.

import {
  MathUtils, Mesh, MeshBasicMaterial, PerspectiveCamera, Raycaster, Scene, SphereGeometry, Vector2,
  Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { drawBar } from "./colours.js";
import { addStyle, button, choice, make } from "./controls.js";
import { Heart, treeLines } from "./heart.js";

const PLAYED_IN = 5; // seconds
const TURN = 0.15; // rad by an arrow key
const CLICK = 5; // pixels that a click may move
const HALF_VIEW = 15; // degrees that the camera sees on either side
const STEPS = 50; // towards the centre of the smallest sphere

// A sphere about all points that is hardly larger than the smallest: the centre goes towards the
// point that is furthest away, by smaller and smaller steps (Badoiu and Clarkson 2003).
function enclosing(points) {
  const centre = new Vector3().fromBufferAttribute(points, 0);
  const point = new Vector3();
  const furthest = new Vector3();
  let reach = 0;
  for (let step = 0; step <= STEPS; step += 1) {
    reach = 0;
    for (let k = 0; k < points.count; k += 1) {
      const away = point.fromBufferAttribute(points, k).distanceTo(centre);
      if (away > reach) {
        reach = away;
        furthest.copy(point);
      }
    }
    if (step < STEPS) centre.lerp(furthest, 1 / (step + 2));
  }
  return { centre, reach };
}

class Viewer {
  constructor(element, data) {
    this.data = data;
    this.scenario = 0;
    this.field = 0;
    this.playing = false;
    this.picked = null;
    addStyle();
    this.canvas = make("canvas", {
      tabindex: 0, role: "img", "aria-label": "heart; drag or use the arrow keys to turn it",
    });
    this.renderer = new WebGLRenderer({
      canvas: this.canvas, antialias: true, alpha: true, preserveDrawingBuffer: true,
    });
    this.build(element);
    this.look();
    this.chooseScenario(0);
    this.listen();
  }

  build(element) {
    const { data } = this;
    this.scene = new Scene();
    this.heart = new Heart(data.surfaces[0], data.box);
    this.scene.add(this.heart.mesh);
    this.marker = new Mesh(new SphereGeometry(1.5), new MeshBasicMaterial({ color: "#d40000" }));
    this.marker.visible = false;
    this.scene.add(this.marker);
    this.trees = [];
    const labels = data.scenarios.map((scenario) => scenario.name);
    const scenario = choice("scenario", labels, (k) => this.chooseScenario(k));
    const field = choice("shown", [], (k) => this.chooseField(k));
    this.fieldSelect = field.select;
    this.slider = make("input", { type: "range", min: 0, step: 0.5, "aria-label": "time (ms)" });
    this.slider.addEventListener("input", () => this.moveTo(Number(this.slider.value)));
    this.play = button("▶", "play or pause", () => this.playOrPause());
    this.clock = make("span", {});
    this.box = make("input", { type: "checkbox" });
    this.box.addEventListener("change", () => this.showTrees());
    this.read = make("span", { "aria-live": "polite" });
    this.barUnit = make("span", {});
    this.bar = make("canvas", { class: "fv-bar", role: "img" });
    const views = ["anterior", "left", "right", "inferior", "base"].map((name) =>
      button(name, `view: ${name}`, () => this.view(name)),
    );
    this.picture = make("div", { class: "fv-picture" }, this.canvas);
    this.root = make(
      "div", { class: "fv" },
      make("div", { class: "fv-row" }, scenario.row, field.row),
      this.picture,
      make("div", { class: "fv-row" }, this.play, this.slider, this.clock),
      make("div", { class: "fv-row fv-keep" }, this.bar, this.barUnit),
      make("div", { class: "fv-row" }, ...views, make("label", {}, this.box, "trees")),
      make("div", { class: "fv-row fv-keep fv-read" }, this.read),
    );
    element.replaceChildren(this.root);
  }

  // The camera, so far away that the heart fills the picture.
  look() {
    const { centre, reach } = enclosing(this.heart.mesh.geometry.getAttribute("position"));
    this.centre = centre;
    this.camera = new PerspectiveCamera(2 * HALF_VIEW, 1, reach / 50, reach * 20);
    this.distance = reach / Math.sin(MathUtils.degToRad(HALF_VIEW));
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.enablePan = false;
    this.orbit.minDistance = reach;
    this.orbit.maxDistance = 8 * reach;
    this.orbit.target.copy(this.centre);
    this.orbit.addEventListener("change", () => this.draw());
    this.view("anterior");
  }

  view(name) {
    const up = new Vector3(...this.data.up);
    const front = new Vector3(...this.data.front);
    const left = new Vector3().crossVectors(up, front);
    const from = {
      anterior: front, left, right: left.clone().negate(), inferior: up.clone().negate(), base: up,
    }[name];
    this.camera.up.copy(["inferior", "base"].includes(name) ? front : up);
    if (name === "base") this.camera.up.negate();
    this.camera.position.copy(this.centre).addScaledVector(from, this.distance);
    this.camera.lookAt(this.centre);
    this.orbit.update();
    this.draw();
  }

  listen() {
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.picture);
    this.canvas.addEventListener("pointerdown", (event) => {
      this.pressed = [event.clientX, event.clientY];
    });
    this.canvas.addEventListener("click", (event) => {
      const [x, y] = this.pressed ?? [event.clientX, event.clientY];
      if (Math.hypot(event.clientX - x, event.clientY - y) < CLICK) {
        this.pick(event.clientX, event.clientY);
      }
    });
    this.canvas.addEventListener("keydown", (event) => this.turnByKey(event));
    this.beforePrint = () => this.toImage();
    this.afterPrint = () => this.toCanvas();
    addEventListener("beforeprint", this.beforePrint);
    addEventListener("afterprint", this.afterPrint);
    this.printed = matchMedia("print");
    this.whenPrinted = (event) => (event.matches ? this.toImage() : this.toCanvas());
    this.printed.addEventListener("change", this.whenPrinted);
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.whenDark = () => this.drawBar();
    this.dark.addEventListener("change", this.whenDark);
  }

  resize() {
    const width = this.picture.clientWidth;
    const height = this.picture.clientHeight;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // the sphere fits the shorter side
    const half = Math.tan(MathUtils.degToRad(HALF_VIEW)) / Math.min(this.camera.aspect, 1);
    this.camera.fov = 2 * MathUtils.radToDeg(Math.atan(half));
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  chooseScenario(k) {
    this.scenario = k;
    const { fields, trees } = this.data.scenarios[k];
    this.fieldSelect.replaceChildren(
      ...fields.map((field, at) => make("option", { value: at }, field.label)),
    );
    this.trees.forEach((lines) => {
      this.scene.remove(lines);
      lines.geometry.dispose();
      lines.material.dispose();
    });
    this.trees = trees.map((tree) => treeLines(tree, this.data.box));
    this.trees.forEach((lines) => this.scene.add(lines));
    this.chooseField(Math.min(this.field, fields.length - 1));
    this.showTrees();
  }

  chooseField(k) {
    this.field = k;
    this.fieldSelect.value = String(k);
    this.shown = this.data.scenarios[this.scenario].fields[k];
    this.heart.show(this.shown);
    this.readPicked();
    this.end = Math.ceil(this.shown.high);
    this.slider.max = this.end;
    this.stop();
    this.slider.disabled = this.play.disabled = this.shown.kind !== "time";
    this.moveTo(this.end);
    this.drawBar();
  }

  moveTo(time) {
    this.time = time;
    this.slider.value = String(time);
    this.clock.textContent = this.shown.kind === "time" ? `${Math.round(time)} ms` : "";
    this.heart.at(time, this.end);
    this.trees.forEach((lines) => {
      lines.material.uniforms.time.value = time >= this.end ? 1e5 : time;
    });
    this.draw();
  }

  showTrees() {
    this.trees.forEach((lines) => (lines.visible = this.box.checked));
    this.heart.seeThrough(this.box.checked);
    this.moveTo(this.time);
  }

  playOrPause() {
    if (this.playing) return this.stop();
    this.playing = true;
    this.play.textContent = "⏸";
    if (this.time >= this.end) this.moveTo(0);
    let before = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      const next = this.time + ((now - before) / 1000 / PLAYED_IN) * this.end;
      before = now;
      this.moveTo(Math.min(next, this.end));
      if (next >= this.end) return this.stop();
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  stop() {
    this.playing = false;
    this.play.textContent = "▶";
    cancelAnimationFrame(this.frame);
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
    this.draw();
  }

  // Value at a place of the window; null beside the heart.
  pick(x, y) {
    const area = this.canvas.getBoundingClientRect();
    const place = new Vector2(
      (2 * (x - area.left)) / area.width - 1, 1 - (2 * (y - area.top)) / area.height,
    );
    const ray = new Raycaster();
    ray.setFromCamera(place, this.camera);
    const [hit] = ray.intersectObject(this.heart.mesh);
    this.marker.visible = Boolean(hit);
    this.picked = hit ? this.heart.nearest(hit.face, hit.point) : null;
    if (hit) this.marker.position.copy(hit.point);
    this.readPicked();
    this.draw();
    return hit ? this.heart.valueAt(this.picked) : null;
  }

  // Writes the value at the place that was picked.
  readPicked() {
    this.read.textContent = this.picked === null ? "Click on the heart for a value." : `${
      this.written(this.heart.valueAt(this.picked))} — ${this.shown.label}, ${
      this.data.scenarios[this.scenario].name}`;
  }

  written(value) {
    if (Number.isNaN(value)) return "never activated";
    const { unit } = this.shown;
    return unit === "1" ? value.toFixed(2) : `${value.toFixed(0)} ${unit}`;
  }

  drawBar() {
    const ink = getComputedStyle(this.root).color;
    drawBar(this.bar, this.shown, ink);
    const unit = this.shown.unit === "1" ? "" : ` (${this.shown.unit})`;
    this.barUnit.textContent = `${this.shown.label}${unit}`;
    this.bar.setAttribute("aria-label", `colours of ${this.barUnit.textContent}`);
  }

  draw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.renderer.render(this.scene, this.camera);
    });
  }

  toImage() {
    if (this.image) return;
    this.renderer.render(this.scene, this.camera);
    this.image = make("img", { src: this.canvas.toDataURL(), alt: "the heart as it was turned" });
    this.canvas.replaceWith(this.image);
  }

  toCanvas() {
    if (!this.image) return;
    this.image.replaceWith(this.canvas);
    this.image = null;
    this.resize();
  }

  state() {
    return {
      scenario: this.data.scenarios[this.scenario].name,
      field: this.shown.name,
      time: this.time,
      playing: this.playing,
      camera: this.camera.position.toArray(),
    };
  }

  dispose() {
    this.stop();
    this.observer.disconnect();
    removeEventListener("beforeprint", this.beforePrint);
    removeEventListener("afterprint", this.afterPrint);
    this.printed.removeEventListener("change", this.whenPrinted);
    this.dark.removeEventListener("change", this.whenDark);
    this.orbit.dispose();
    this.heart.dispose();
    this.renderer.dispose();
    this.root.remove();
  }
}

window.fascicleViewer = (element, data) => {
  const probe = document.createElement("canvas");
  if (!probe.getContext("webgl2")) {
    element.textContent = "This browser has no WebGL, which the heart is drawn with.";
    return null;
  }
  return new Viewer(element, data);
};
