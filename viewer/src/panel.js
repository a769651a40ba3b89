// One scenario: a stage with the heart, its Purkinje network, and what is written over them.

import { Mesh, MeshBasicMaterial, SphereGeometry, Vector3 } from "three";
import { BullsEye } from "./bullseye.js";
import { make } from "./controls.js";
import { positions, segments, times } from "./data.js";
import { Heart, Tree } from "./heart.js";
import { isochrones, Overlay } from "./overlay.js";
import { enclosing, Stage } from "./stage.js";

const ISOCHRONES = 20; // ms between those with a label

export class Panel {
  constructor(data) {
    this.data = data;
    this.canvas = make("canvas", {
      tabindex: 0, role: "img", "aria-label": "heart; drag or use the arrow keys to turn it",
    });
    this.title = make("div", { class: "fv-title" });
    this.picture = make("div", { class: "fv-picture" }, this.canvas);
    this.root = make("div", { class: "fv-panel" }, this.title, this.picture);
    this.heart = new Heart(data.surfaces[0], data.box);
    this.template = this.heart.mesh.geometry.getAttribute("position").array.slice();
    this.hearts = (data.hearts ?? []).map((packed) => positions(packed, data.box));
    this.placed = this.template; // which of them is shown
    const reach = (points) => enclosing(points).reach;
    this.stage = new Stage(this.canvas, this.picture, {
      up: data.up, front: data.front, base: data.base,
      points: this.hearts.reduce((a, b) => (reach(b) > reach(a) ? b : a), this.template),
    });
    this.overlay = new Overlay(this.stage, data);
    this.bullsEye = new BullsEye(); // where the page puts it
    this.stage.add(this.heart.mesh);
    this.marker = new Mesh(new SphereGeometry(1.5), new MeshBasicMaterial({ color: "#d40000" }));
    this.marker.visible = false;
    this.stage.add(this.marker);
    this.trees = [];
    this.drawn = null; // which trees
  }

  // A scenario in a network, coloured by a field or, without one, by the network's activation.
  show(scenario, network, field) {
    this.scenario = scenario;
    this.title.textContent = scenario.title;
    // of hearts of an atlas, what is of all networks is shown on the template, without theirs
    this.ofAll = Boolean(field && this.data.hearts);
    this.place(this.data.hearts && !field ? this.hearts[this.data.heart[network]] : this.template);
    const { low, high, top } = this.data.times;
    this.heart.show(field ?? {
      kind: "time", low: 0, high: top, values: times(scenario.activations[network], 0, high),
    });
    const numbers = scenario.trees[network];
    const known = scenario.tree_times[network].map((text) => times(text, low, high));
    if (String(numbers) === this.drawn) this.trees.forEach((tree, k) => tree.update(known[k]));
    else this.drawTrees(numbers, known);
    this.marks = (this.ofAll ? [] : scenario.marks[network] ?? []).map((mark) => ({
      ...mark, place: new Vector3(...mark.place),
    }));
    const levels = Array.from({ length: top / ISOCHRONES }, (_, k) => ISOCHRONES * (k + 1));
    const timed = this.heart.field.kind === "time";
    const begins = field ? "" : scenario.first[network];
    const first = begins ? `first activation: ${begins}` : "first activation";
    this.isochrones = timed ? isochrones(this.heart, levels, this.stage.reach, first) : [];
    this.label();
  }

  // Shows the surface at the positions of a heart, with the marker on the same vertex.
  place(points) {
    if (points === this.placed) return;
    this.placed = points;
    this.heart.place(points);
    this.stage.centreOn(points);
    if (this.picked != null) this.marker.position.fromArray(points, 3 * this.picked);
  }

  drawTrees(numbers, known) {
    const visible = this.trees[0]?.mesh.visible ?? true;
    this.removeTrees();
    this.drawn = String(numbers);
    this.trees = numbers.map((number, k) => {
      const tree = this.data.trees[number];
      // unpacked once for both panels
      tree.unpacked ??= {
        nodes: positions(tree.nodes, this.data.box), segments: segments(tree.before),
      };
      return new Tree({ ...tree.unpacked, times: known[k] }, this.data.box, this.heart);
    });
    this.trees.forEach(({ mesh }) => {
      mesh.visible = visible;
      this.stage.add(mesh);
    });
  }

  removeTrees() {
    this.trees.forEach((tree) => {
      this.stage.remove(tree.mesh);
      tree.dispose();
    });
  }

  // Isochrones, of an opaque heart on all that is drawn, of a translucent one on the endocardia; and
  // the scenario's marks.
  label() {
    const { heart, opaque } = this;
    const only = this.only || !opaque;
    this.endocardial ??= new Set(heart.triangles.subarray(0, 3 * heart.endocardial));
    const seen = this.isochrones.filter(({ vertex }) => !only || this.endocardial.has(vertex));
    this.overlay.labels = [...(this.labelled ? seen : []), ...this.marks];
    this.stage.draw();
  }

  // How everything is drawn: {opaque, only (endocardia), networks, cut (share), labelled, early}.
  look({ opaque, only, networks, cut, labelled, early }) {
    this.only = only;
    this.opaque = opaque;
    this.labelled = labelled;
    this.heart.colourTimes(early);
    this.heart.seeThrough(!opaque);
    this.overlay.opaque = opaque;
    this.heart.onlyEndocardia(only);
    this.trees.forEach(({ mesh }) => (mesh.visible = networks && !this.ofAll));
    this.stage.cut = cut;
    this.heart.cutBy(cut ? this.stage.clip : null);
    this.label();
  }

  at(time, end) {
    this.heart.at(time, end);
    this.overlay.time = time >= end ? Infinity : time;
    this.stage.draw();
  }

  // Puts the marker where a ray meets the heart; its vertex, or null beside the heart.
  pick(ray) {
    const hit = this.heart.hit(ray);
    this.marker.visible = Boolean(hit);
    if (hit) this.marker.position.copy(hit.point);
    this.stage.draw();
    this.picked = hit ? hit.vertex : null;
    return this.picked;
  }

  dispose() {
    this.removeTrees();
    this.heart.dispose();
    this.stage.dispose();
    this.root.remove();
    this.bullsEye.root.remove();
  }
}
