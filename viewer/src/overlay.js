// What is written over the picture of a heart: isochrones, marks, and which way the body faces.

import { Vector3 } from "three";
import { make } from "./controls.js";

const SIZE = 12; // pixels of letters
const MOST = 4; // labels of an isochrone
const KINDS = { paced: "★", blocked: "✕", scar: "▨", first: "●", electrode: "●" };
const OF_SCENARIO = ["paced", "blocked", "scar"];
const COLOURS = { paced: "#c00000", blocked: "#c00000", scar: "#555555", first: "#000000",
  electrode: "#1f5fa8" };

// Places on the surface where a time is reached, a few for each, well apart, and where it begins.
export function isochrones(heart, levels, reach, begins) {
  const place = heart.mesh.geometry.getAttribute("position");
  const normal = heart.mesh.geometry.getAttribute("normal");
  const at = (attribute, vertex) => new Vector3().fromBufferAttribute(attribute, vertex);
  const label = (vertex, kind, text, time) => ({
    kind, text, time, vertex, place: at(place, vertex), normal: at(normal, vertex),
  });
  const found = [];
  for (const level of levels) {
    const near = [];
    for (let k = 0; k < place.count; k++) {
      if (Math.abs(heart.valueAt(k) - level) < 1) near.push(k);
    }
    const taken = [];
    for (const vertex of near) {
      const here = at(place, vertex);
      if (taken.length === MOST) break;
      if (taken.every((other) => other.place.distanceTo(here) > 0.6 * reach)) {
        taken.push(label(vertex, "isochrone", String(level), level));
      }
    }
    found.push(...taken);
  }
  let first = 0;
  for (let k = 1; k < place.count; k++) {
    if (!(heart.valueAt(k) >= heart.valueAt(first))) first = k;
  }
  found.push(label(first, "first", begins, 0));
  return found;
}

export class Overlay {
  constructor(stage, { up, front }) {
    this.stage = stage;
    this.labels = []; // {kind, text, time, place, normal}
    this.opaque = false;
    this.time = Infinity;
    const [head, anterior] = [up, front].map((axis) => new Vector3(...axis));
    const left = new Vector3().crossVectors(head, anterior);
    this.axes = [[left, "L", "R"], [anterior, "A", "P"], [head, "H", "F"]];
    this.canvas = make("canvas", { class: "fv-over", "aria-hidden": "true" });
    stage.picture.append(this.canvas);
    stage.onRender = () => this.paint();
  }

  paint() {
    const { picture } = this.stage;
    const [width, height] = [picture.clientWidth, picture.clientHeight];
    const ratio = Math.min(devicePixelRatio, 2);
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    const pen = this.canvas.getContext("2d", { willReadFrequently: true });
    pen.scale(ratio, ratio);
    pen.font = `${SIZE}px system-ui, sans-serif`;
    pen.textBaseline = "middle";
    pen.lineJoin = "round";
    const place = (label) => {
      const { x, y } = label.place.clone().project(this.stage.camera);
      return [((x + 1) / 2) * width, ((1 - y) / 2) * height];
    };
    const ends = [];
    const marked = this.labels.filter(({ kind }) => OF_SCENARIO.includes(kind)).map(place);
    for (const label of this.labels.filter((each) => this.shows(each))) {
      const at = place(label);
      // isochrones give way to one another
      if (label.kind === "isochrone") {
        if (ends.some((end) => Math.hypot(end[0] - at[0], end[1] - at[1]) < 2.2 * SIZE)) continue;
        ends.push(at);
      }
      // a mark at the first activation says more than that it is the first
      const near = (end) => Math.hypot(end[0] - at[0], end[1] - at[1]) < 3 * SIZE;
      if (label.kind === "first" && marked.some(near)) continue;
      this.write(pen, label, ...at, width);
    }
    this.paintAxes(pen, height);
  }

  // What lies on the near side, is not cut away and was reached; marks always.
  shows({ kind, time, place, normal }) {
    if (!normal) return true;
    if (time > this.time || this.stage.isCut(place)) return false;
    if (kind === "first" && !this.opaque) return true;
    return normal.dot(this.stage.camera.position.clone().sub(place)) > 0;
  }

  write(pen, { kind, text }, x, y, width) {
    const said = kind === "blocked" ? `${text} blocked` : text;
    const sign = KINDS[kind] ?? "";
    pen.font = `${kind === "isochrone" ? "" : "600 "}${SIZE}px system-ui, sans-serif`;
    pen.strokeStyle = "rgb(255 255 255 / 85%)";
    pen.lineWidth = 3.5;
    pen.fillStyle = COLOURS[kind] ?? "#000000";
    const put = (letters, at, line) => {
      pen.strokeText(letters, at, line);
      pen.fillText(letters, at, line);
    };
    pen.textAlign = "center";
    if (!sign) return put(said, x, y);
    put(sign, x, y);
    // to the right of the sign, or to the left, or below
    pen.textAlign = "left";
    const long = pen.measureText(said).width;
    const away = 0.7 * SIZE;
    if (x + away + long < width - 3) put(said, x + away, y);
    else if (x - away - long > 3) put(said, x - away - long, y);
    else put(said, Math.max(3, Math.min(x - long / 2, width - 3 - long)), y + 1.3 * SIZE);
  }

  // Letters of left, right, anterior, posterior, head and feet, as they lie to the eye.
  paintAxes(pen, height) {
    const arm = 22;
    const [x, y] = [arm + 14, height - arm - 14];
    const turned = this.stage.camera.matrixWorldInverse;
    const ends = this.axes.flatMap(([axis, there, back]) => {
      const seen = axis.clone().transformDirection(turned);
      return [[seen, there], [seen.clone().negate(), back]];
    });
    const ink = getComputedStyle(this.stage.picture).color;
    pen.textAlign = "center";
    pen.font = `600 ${SIZE}px system-ui, sans-serif`;
    for (const [seen, letter] of ends.sort((a, b) => a[0].z - b[0].z)) {
      const towards = Math.hypot(seen.x, seen.y) < 0.25;
      if (seen.z < -0.3) continue; // on the far side
      pen.strokeStyle = pen.fillStyle = ink;
      pen.lineWidth = 1.5;
      if (!towards) {
        pen.beginPath();
        pen.moveTo(x + arm * 0.35 * seen.x, y - arm * 0.35 * seen.y);
        pen.lineTo(x + arm * 0.7 * seen.x, y - arm * 0.7 * seen.y);
        pen.stroke();
      }
      pen.fillText(letter, x + arm * seen.x, y - arm * seen.y);
    }
  }
}
