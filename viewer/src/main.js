// A heart that can be turned: activations of scenarios on its surface, the front over time, trees.

import { Mesh, MeshBasicMaterial, SphereGeometry } from "three";
import { drawBar } from "./colours.js";
import { addStyle, button, choice, make } from "./controls.js";
import { Heart, Tree } from "./heart.js";
import { Stage } from "./stage.js";
import "./explorer.js";

const PLAYED_IN = 5; // seconds

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
    this.build(element);
    this.chooseScenario(0);
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.whenDark = () => this.drawBar();
    this.dark.addEventListener("change", this.whenDark);
  }

  build(element) {
    const { data } = this;
    this.heart = new Heart(data.surfaces[0], data.box);
    this.marker = new Mesh(new SphereGeometry(1.5), new MeshBasicMaterial({ color: "#d40000" }));
    this.marker.visible = false;
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
    this.picture = make("div", { class: "fv-picture" }, this.canvas);
    this.stage = new Stage(this.canvas, this.picture, {
      up: data.up, front: data.front, base: data.base,
      points: this.heart.mesh.geometry.getAttribute("position").array,
    });
    this.stage.add(this.heart.mesh);
    this.stage.add(this.marker);
    this.stage.onClick = (ray) => this.pick(ray);
    const views = Object.keys(this.stage.views).map((name) =>
      button(name, `view: ${name}`, () => this.stage.view(name)),
    );
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

  chooseScenario(k) {
    this.scenario = k;
    const { fields, trees } = this.data.scenarios[k];
    this.fieldSelect.replaceChildren(
      ...fields.map((field, at) => make("option", { value: at }, field.label)),
    );
    this.trees.forEach((tree) => {
      this.stage.remove(tree.mesh);
      tree.dispose();
    });
    this.trees = trees.map((tree) => new Tree(tree, this.data.box, this.heart));
    this.trees.forEach((tree) => this.stage.add(tree.mesh));
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
    this.stage.draw();
  }

  showTrees() {
    this.trees.forEach((tree) => (tree.mesh.visible = this.box.checked));
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

  // Value where a ray meets the heart; null beside it.
  pick(ray) {
    const hit = this.heart.hit(ray);
    this.marker.visible = Boolean(hit);
    this.picked = hit ? hit.vertex : null;
    if (hit) this.marker.position.copy(hit.point);
    this.readPicked();
    this.stage.draw();
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

  state() {
    return {
      scenario: this.data.scenarios[this.scenario].name,
      field: this.shown.name,
      time: this.time,
      playing: this.playing,
      camera: this.stage.camera.position.toArray(),
    };
  }

  dispose() {
    this.stop();
    this.dark.removeEventListener("change", this.whenDark);
    this.trees.forEach((tree) => tree.dispose());
    this.heart.dispose();
    this.stage.dispose();
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
