// A heart to explore: its networks, activation and ECG follow every change of a state.

import { Vector2, Vector3 } from "three";
import { GIFEncoder, applyPalette, quantize } from "gifenc";
import { ColourBar, ZERO } from "./colours.js";
import { addStyle, button, check, choice, hasWebGL, make } from "./controls.js";
import { EcgPaper } from "./ecg.js";
import { EXERCISES } from "./exercises.js";
import { Heart, Tree } from "./heart.js";
import { unpacked } from "./message.js";
import { Overlay } from "./overlay.js";
import { Player } from "./player.js";
import { Stage } from "./stage.js";

const PLAYED_IN = 4; // seconds
const FROM = -40; // ms before the first activation that the ECG is shown from
const NEAR = 4; // mm from the line of sight that a branch may be
const FRAMES = 24; // of a film
const TALL = 360; // pixels of its frames
const SCALE = { speed: 100, gain: 10 }; // mm/s, mm/mV
const GRASP = 14; // pixels about an electrode
const NOTES = {
  tissue: "Each change prepares the tissue again when you release the slider: some seconds.",
  heart: "Hearts of the population. Each is prepared when it is first shown: some seconds.",
  torso: "The first change computes the lead fields of other torsos: a few minutes, once per heart.",
};
const SIMULATED = "#b34700";
const RECORDED = "#1f5fa8";
const PINNED = "#777777";

const begun = (values) => ({
  values: { ...values }, scenario: "intrinsic", stimuli: [], blocks: [], scars: [], network: null,
});
const copy = (state) => JSON.parse(JSON.stringify(state));

export class Explorer {
  // `send(message)` takes what a session answers; its answers go to `heard`.
  constructor(element, send) {
    addStyle();
    element.classList.add("fv", "fx");
    this.element = element;
    this.send = send;
    this.number = 0;
    this.past = [];
    this.busy = false;
    this.waiting = false;
    this.pinned = null;
    this.latencies = [];
    element.replaceChildren(make("p", { role: "status" }, "The heart is being prepared …"));
  }

  heard(buffer) {
    const { said, arrays } = unpacked(buffer);
    if (said.groups) this.begin(said, arrays);
    else if (said.progress) this.say(said.progress);
    else if (said.files) this.download(said.files);
    else this.show(said, arrays);
  }

  // The first message: what does not change.
  begin(said, arrays) {
    this.said = said;
    this.fixed = arrays;
    this.state = begun(said.start);
    this.build();
    this.showState();
    this.ask();
  }

  build() {
    const { said, fixed } = this;
    this.canvas = make("canvas", {
      tabindex: 0, role: "img", "aria-label": "heart; drag or use the arrow keys to turn it",
    });
    this.picture = make("div", { class: "fv-picture" }, this.canvas);
    this.stage = new Stage(this.canvas, this.picture, {
      up: said.up, front: said.front, base: said.base, points: fixed.vertices,
    });
    this.paper = make("div", { class: "fx-paper" });
    this.bar = new ColourBar();
    this.status = make("p", { role: "status", class: "fx-status" });
    this.measured = make("dl", { class: "fx-measured" });
    this.element.replaceChildren(
      make("h1", {}, said.heart, make("small", {}, said.verdict ?? "example network")),
      make("div", { class: "fx-top" },
        make("section", { "aria-label": "heart" }, this.actions(), this.picture, this.timeRow(),
          make("div", { class: "fv-row" }, this.bar.canvas, this.bar.text)),
        make("section", { "aria-label": "ECG" }, this.paper, this.measured, this.status)),
      this.networkRow(),
      this.sliders(),
      this.exercises(),
    );
    this.heart = new Heart({
      vertices: fixed.vertices, triangles: fixed.triangles, endocardial: said.endocardial,
      index: Uint32Array.from({ length: fixed.vertices.length / 3 }, (_, k) => k),
    });
    this.heart.seeThrough(true);
    this.stage.add(this.heart.mesh);
    this.stage.onClick = (ray) => this.clicked(ray);
    this.stage.onPress = (x, y) => this.grasped(x, y);
    this.overlay = new Overlay(this.stage, said);
    this.trees = [];
    this.ecg = new EcgPaper(this.paper);
    this.ecg.onCursor = (ms) => this.moveTo(ms);
    this.keys = (event) => {
      if ((event.ctrlKey || event.metaKey) && event.key === "z") {
        event.preventDefault();
        this.undo();
      }
    };
    addEventListener("keydown", this.keys);
  }

  actions() {
    const { said } = this;
    this.mode = choice("click", ["read a time", "pace here", "block a branch", "make a scar"], () => {});
    this.scenario = choice("beat", Object.values(said.scenarios), (k) =>
      this.change((state) => (state.scenario = Object.keys(said.scenarios)[k])));
    this.conduction = choice("conduction", said.conduction, (k) =>
      this.change((state) => (state.values.conduction = k)));
    this.opaque = check("opaque", false, () => {
      this.heart.seeThrough(!this.opaque.box.checked);
      this.stage.draw();
    });
    this.electrodes = check("electrodes", false, () => {
      this.hold();
      this.mark();
    });
    this.electrodes.box.disabled = true; // they come with the first beat
    const fire = [["fire His", "his-pacing"], ["left bundle", "left-bundle-branch-pacing"],
                  ["right apex", "rv-apical-pacing"]];
    return make("div", {},
      make("div", { class: "fv-row" }, this.mode.row, this.scenario.row, this.conduction.row),
      make("div", { class: "fv-row" },
        ...fire.map(([text, name]) => button(text, `${text}: ${said.scenarios[name]}`, () =>
          this.change((state) => Object.assign(state, { scenario: name, stimuli: [] })))),
        button("undo", "undo (Ctrl+Z)", () => this.undo()),
        button("start again", "start again", () => this.change((state) =>
          Object.assign(state, begun(said.start)))),
        button("pin", "pin this beat to compare with", () => this.pin()),
        button("save", "save parameters and scenario", () => this.save()),
        button("picture", "save a picture", () => this.savePicture()),
        button("film", "save a film", () => this.saveFilm())),
      make("div", { class: "fv-row" },
        ...Object.keys(this.stage.views).map((name) => button(name, `view: ${name}`, () => this.stage.view(name))),
        this.opaque.row, this.electrodes.row));
  }

  // Shows the heart, with its electrodes if they are asked for.
  hold() {
    const places = this.electrodes.box.checked ? this.chest().flatMap(({ place }) => place.toArray()) : [];
    this.stage.hold(Float32Array.from([...this.fixed.vertices, ...places]));
  }

  // The surface of another heart of an atlas.
  place(vertices) {
    if (vertices.every((x, k) => x === this.fixed.vertices[k])) return;
    this.fixed.vertices = vertices;
    this.heart.place(vertices);
    if (this.electrodes.box.checked) this.hold();
    else this.stage.centreOn(vertices);
  }

  timeRow() {
    this.time = Infinity;
    this.player = new Player(this, PLAYED_IN);
    this.clock = make("span", { class: "fx-clock" });
    this.slider = make("input", {
      type: "range", min: 0, max: 200, step: 1, value: 200,
      "aria-label": "time after the first ventricular activation (ms)",
    });
    this.slider.addEventListener("input", () => this.moveTo(Number(this.slider.value)));
    return make("div", { class: "fv-row" }, this.player.button, this.slider, this.clock);
  }

  networkRow() {
    const { networks } = this.said;
    if (!networks.length) return "";
    this.which = make("input", {
      type: "range", min: 1, max: networks.length, value: 1, step: 1, "aria-label": "network",
    });
    this.whichSaid = make("span", {});
    this.which.addEventListener("input", () => {
      const k = Number(this.which.value);
      this.change((state) => {
        this.leave(state, networks[k - 1].atlas_heart);
        Object.assign(state, { values: { ...networks[k - 1] }, network: k - 1 });
      });
    });
    return make("div", { class: "fv-row" }, "networks of the study", this.which, this.whichSaid);
  }

  sliders() {
    this.inputs = {};
    const [first, ...more] = this.said.groups.map(({ name, sliders }) =>
      make("div", { class: "fx-sliders" }, ...sliders.map((each) => this.parameter(each, name))));
    const [, ...titles] = this.said.groups.map(({ name }) => name);
    return make("section", { "aria-label": "parameters" }, first, ...more.map((rows, k) =>
      make("details", {}, make("summary", {}, titles[k]), NOTES[titles[k]] ?? "", rows)));
  }

  // A parameter of a group: its slider, with the distribution in the study above it, and its value,
  // which can be typed: Enter applies it, Escape restores what it was.
  parameter({ name, low, high, label, unit, meaning, posterior, value: own, step }, group) {
    const input = make("input", {
      type: "range", min: low, max: high, step: step ?? (high - low) / 400, "aria-label": label,
      title: meaning,
    });
    const field = make("input", {
      type: "text", inputmode: "decimal", autocomplete: "off", title: `${low} to ${high} ${unit}`,
      "aria-label": unit ? `${label} (${unit})` : label,
    });
    const digits = step || high - low > 20 ? 0 : high - low > 1 ? 2 : 3;
    const slow = ["tissue", "heart"].includes(group);
    const written = (at) => (Number.isFinite(at) ? at.toFixed(digits) : "∞");
    this.inputs[name] = { input, field, written, own };
    input.addEventListener("input", () => {
      if (!slow) this.slide(name, { [name]: Number(input.value) });
      else field.value = written(Number(input.value));
    });
    const apply = (at) => {
      if (slow) this.say(`The ${group} is being prepared …`);
      this.change((state) => {
        if (group === "heart") this.leave(state, at);
        state.values[name] = at;
      });
    };
    input.addEventListener("change", () => (slow ? apply(Number(input.value)) : this.rest()));
    field.addEventListener("change", () => {
      const at = field.value.trim() ? Number(field.value.replace(",", ".")) : NaN;
      if (at >= low && at <= high && !(step && at % step)) {
        field.defaultValue = at;
        return apply(at);
      }
      this.showState();
      this.say(`${label}: give ${step ? "a whole number, " : ""}${low} to ${high} ${unit}`.trim());
    });
    field.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.showState();
    });
    return make("div", { class: "fx-slider", "data-name": name },
      make("span", {}, label), field, make("span", {}, unit), density(posterior), input);
  }

  exercises() {
    const rows = EXERCISES.map(({ name, conduction, text }) =>
      make("details", {}, make("summary", {}, name), make("p", {}, text),
        button("begin", `begin: ${name}`, () => this.change((state) =>
          Object.assign(state, begun({ ...this.said.start, conduction }))))));
    return make("section", { "aria-label": "exercises" }, make("h2", {}, "Five exercises"), ...rows);
  }

  // Places that were clicked are of one heart: another one of an atlas has none of them.
  leave(state, heart) {
    if (state.values.atlas_heart === heart) return;
    Object.assign(state, { stimuli: [], blocks: [], scars: [] });
    this.say("The heart is being prepared …");
  }

  // One entry of the history for a whole movement; meanwhile the picture is coarse.
  slide(name, values) {
    const same = this.sliding === name;
    this.sliding = name;
    this.stage.coarse(true);
    this.change((state) => Object.assign(state.values, values), !same);
  }

  // The hand rests: the picture is fine, and all numbers are there.
  rest() {
    this.sliding = null;
    this.stage.coarse(false);
    this.ask();
  }

  change(how, remember = true) {
    if (remember) this.past.push(copy(this.state));
    how(this.state);
    this.showState();
    this.ask();
  }

  undo() {
    const before = this.past.pop();
    if (!before) return this.say("Nothing to undo.");
    this.state = before;
    this.showState();
    this.ask();
  }

  // Asks for the present state; while an answer is awaited the latest state waits, and no other.
  ask() {
    this.waiting = true;
    if (this.busy) return;
    this.waiting = false;
    this.busy = true;
    this.number += 1;
    this.asked = performance.now();
    this.send({ id: this.number, state: this.state, moving: Boolean(this.sliding) });
  }

  showState() {
    const { values, scenario, network } = this.state;
    for (const [name, { input, field, written, own }] of Object.entries(this.inputs)) {
      const at = Number(values[name] ?? own ?? NaN); // "Infinity" comes as a word
      input.value = Math.min(at, input.max);
      // the default of the field is the state's value, with all digits if they were typed
      if (Number.isNaN(at)) field.defaultValue = "";
      else if (Number(field.defaultValue || NaN) !== at) field.defaultValue = written(at);
      field.value = field.defaultValue;
    }
    this.scenario.select.value = Object.keys(this.said.scenarios).indexOf(scenario);
    this.conduction.select.value = values.conduction ?? 0;
    if (!this.which) return;
    this.which.value = network === null ? 1 : network + 1;
    this.whichSaid.textContent = network === null
      ? "best network" : `network ${network + 1} of ${this.said.networks.length}`;
  }

  show(said, arrays) {
    this.busy = false;
    if (said.error) this.say(said.error);
    else this.showBeat(said, arrays);
    if (this.waiting) this.ask();
    requestAnimationFrame(() => this.latencies.push(performance.now() - this.asked));
  }

  showBeat(said, arrays) {
    this.beat = { said, arrays };
    this.electrodes.box.disabled = false;
    const { activation, vertices } = arrays;
    if (vertices) this.place(vertices);
    const end = Math.ceil(activation.reduce((a, b) => (b > a && b < Infinity ? b : a), 0));
    this.end = end;
    const field = {
      kind: "time", values: activation.map((t) => (t < Infinity ? t : NaN)), low: 0, high: end,
      label: "activation", unit: "ms",
    };
    this.heart.show(field);
    this.bar.show(field, this.heart.early, getComputedStyle(this.element).color);
    this.trees.forEach((tree) => {
      this.stage.remove(tree.mesh);
      tree.dispose();
    });
    this.trees = said.trees.map((side) => new Tree({
      nodes: arrays[`${side}_nodes`], segments: arrays[`${side}_segments`],
      values: arrays[`${side}_times`],
    }, null, this.heart));
    this.trees.forEach((tree) => this.stage.add(tree.mesh));
    this.mark();
    this.slider.max = end;
    this.drawEcg();
    this.moveTo(this.time >= (this.ended ?? 0) ? end : Math.min(this.time, end));
    this.ended = end;
    this.say("");
    this.write(said);
  }

  // All traces on one clock, whose window changes in steps, so that the paper stays where it is.
  drawEcg() {
    const { said, arrays } = this.beat;
    const end = Math.max(160, 20 * Math.ceil((this.end + 50) / 20));
    const trace = (name, colour, { said: { ecg_start }, arrays: given }, values = given[name]) => ({
      name, colour, values: this.byLead(values, ecg_start, end),
    });
    const traces = [trace("simulated", SIMULATED, this.beat)];
    if (arrays.recorded) traces.unshift(trace("recorded", RECORDED, this.beat));
    if (this.pinned) {
      const before = trace("pinned", PINNED, this.pinned, this.pinned.arrays.simulated);
      traces.unshift({ ...before, dashed: true });
    }
    const { leads } = this.said;
    this.ecg.show({ leads, start: FROM, step: 1, traces, zero: ZERO, scale: SCALE });
  }

  // Potentials of each lead every ms from FROM to an end, of samples that begin at a time.
  byLead(values, start, end) {
    const { leads } = this.said;
    const length = values.length / leads.length;
    const sampled = (first) => Float32Array.from({ length: end - FROM + 1 }, (_, k) => {
      const at = FROM + k - start;
      const below = Math.floor(at);
      if (below < 0 || below + 1 >= length) return NaN;
      return values[first + below] + (at - below) * (values[first + below + 1] - values[first + below]);
    });
    return Object.fromEntries(leads.map((lead, k) => [lead, sampled(k * length)]));
  }

  write(said) {
    const was = this.pinned?.said;
    const rows = [
      ["QRS duration", said.qrs, was?.qrs, "ms"], ["total activation", said.total, was?.total, "ms"],
      ["frontal axis", said.axis, was?.axis, "°"],
    ].map(([name, now, before, unit]) => [name, `${now.toFixed(0)} ${unit}${
      before === undefined ? "" : ` (pinned ${before.toFixed(0)})`}`]);
    if (said.explained !== undefined) {
      rows.push(["of the recorded QRS explained", `${(100 * said.explained).toFixed(0)} %`]);
    }
    const met = said.criteria ? said.criteria.join("; ") || "none" : "…";
    rows.push(["conventional criteria met", met]);
    this.measured.replaceChildren(
      ...rows.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]),
    );
  }

  say(text) {
    this.status.textContent = text;
  }

  moveTo(ms) {
    this.time = Math.min(Math.max(ms, 0), this.end);
    this.slider.value = this.time;
    this.clock.textContent = `${Math.round(this.time)} ms after the first activation`;
    this.heart.at(this.time, this.end);
    this.ecg.cursor(this.time);
    this.stage.draw();
  }

  clicked(ray) {
    const ways = [
      () => this.readAt(ray), () => this.placeAt(ray, "stimuli"), () => this.blockAt(ray),
      () => this.placeAt(ray, "scars"),
    ];
    ways[this.mode.select.value]();
  }

  readAt(ray) {
    const hit = this.heart.hit(ray);
    if (!hit) return;
    const time = this.heart.valueAt(hit.vertex);
    this.say(Number.isNaN(time) ? "never activated" : `activated after ${time.toFixed(0)} ms`);
  }

  placeAt(ray, kind) {
    const hit = this.heart.hit(ray);
    if (!hit) return;
    const place = [...this.fixed.vertices.subarray(3 * hit.vertex, 3 * hit.vertex + 3)];
    if (kind === "scars") this.say("The heart with this scar is being prepared …");
    this.change((state) => state[kind].push(place));
  }

  // Blocks the branch that is nearest to the line of sight.
  blockAt(ray) {
    const point = new Vector3();
    let best = { away: NEAR };
    for (const side of this.beat.said.trees) {
      const nodes = this.beat.arrays[`${side}_nodes`];
      for (let k = 0; k < nodes.length; k += 3) {
        const away = ray.ray.distanceToPoint(point.fromArray(nodes, k));
        if (away < best.away) best = { away, side, place: [...nodes.subarray(k, k + 3)] };
      }
    }
    if (!best.side) return this.say("Click nearer to a branch of the network.");
    this.change((state) => state.blocks.push([best.side, best.place]));
  }

  // What was done, and where activation begins.
  mark() {
    const { stimuli, blocks, scars } = this.state;
    const mark = (kind, text, place) => ({ kind, text, place: new Vector3(...place), time: 0 });
    const { activation } = this.beat.arrays;
    const first = activation.indexOf(activation.reduce((a, b) => Math.min(a, b)));
    this.overlay.labels = [
      ...stimuli.map((place) => mark("paced", "paced", place)),
      ...blocks.map(([, place]) => mark("blocked", "branch", place)),
      ...scars.map((place) => mark("scar", "scar", place)),
    ];
    if (!stimuli.length) {
      const place = this.fixed.vertices.subarray(3 * first, 3 * first + 3);
      this.overlay.labels.push(mark("first", "first activation", place));
    }
    if (this.electrodes.box.checked) this.overlay.labels.push(...this.chest());
    this.stage.draw();
  }

  // Marks of V1 to V6, where they are.
  chest() {
    const { electrodes } = this.beat.arrays;
    return Array.from({ length: 6 }, (_, k) => ({
      kind: "electrode", text: `V${k + 1}`, time: 0, name: `v${k + 1}`,
      place: new Vector3().fromArray(electrodes, 3 * (3 + k)),
    }));
  }

  // What moves the chest electrode at a place of the window; null where there is none.
  grasped(x, y) {
    if (!this.electrodes.box.checked) return null;
    const away = ({ place }) => Math.hypot(...this.stage.onScreen(place).sub(new Vector2(x, y)));
    const [nearest] = this.chest().sort((a, b) => away(a) - away(b));
    if (away(nearest) > GRASP) return null;
    if (!this.inputs[`${nearest.name}_left`]) {
      this.say("This heart has no torso: its electrodes stay.");
      return null;
    }
    const names = [`${nearest.name}_left`, `${nearest.name}_up`];
    const before = names.map((name) => Number(this.state.values[name] ?? 0));
    const along = this.stage.alongSkin(nearest.place);
    return {
      move: (dx, dy) => {
        const moved = along(dx, dy).map((mm, k) => {
          const { min, max } = this.inputs[names[k]].input;
          return [names[k], Math.min(Math.max(before[k] + mm, Number(min)), Number(max))];
        });
        this.slide(nearest.name, Object.fromEntries(moved));
      },
      end: () => this.rest(),
    };
  }

  pin() {
    this.pinned = this.beat;
    this.drawEcg();
    this.write(this.beat.said);
  }

  save() {
    this.send({ id: 0, ask: "files", state: this.state });
  }

  download(files) {
    for (const [name, text] of Object.entries(files)) keep(name, new Blob([text]));
  }

  savePicture() {
    this.frame(2 * TALL).toBlob((blob) => keep("heart.png", blob));
  }

  // The heart, what is written over it, and the ECG to its right.
  frame(height = TALL) {
    this.stage.render();
    this.ecg.paint();
    const parts = [this.canvas, this.paper.querySelector("canvas")];
    const widths = parts.map((each) => Math.round((height * each.width) / each.height));
    const canvas = make("canvas", { width: widths[0] + widths[1], height });
    const pen = canvas.getContext("2d", { willReadFrequently: true });
    pen.fillStyle = "#fff";
    pen.fillRect(0, 0, canvas.width, height);
    pen.drawImage(parts[0], 0, 0, widths[0], height);
    pen.drawImage(this.overlay.canvas, 0, 0, widths[0], height);
    pen.drawImage(parts[1], widths[0], 0, widths[1], height);
    return canvas;
  }

  async saveFilm() {
    keep("heart.gif", new Blob([await this.film()], { type: "image/gif" }));
  }

  // The front through trees and tissue, as GIF.
  async film() {
    const film = GIFEncoder();
    const until = this.time;
    for (let k = 0; k <= FRAMES; k += 1) {
      this.moveTo((k / FRAMES) * this.end);
      const canvas = this.frame();
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      const palette = quantize(data, 32);
      film.writeFrame(applyPalette(data, palette), canvas.width, canvas.height, {
        palette, delay: k === FRAMES ? 1500 : 120,
      });
      this.say(`film: ${k} of ${FRAMES}`);
      await new Promise((done) => setTimeout(done));
    }
    film.finish();
    this.moveTo(until);
    this.say("");
    return film.bytes();
  }

  dispose() {
    this.player?.stop();
    removeEventListener("keydown", this.keys);
    this.stage?.dispose();
    this.ecg?.dispose();
    this.heart?.dispose();
  }
}

// A file for the reader.
function keep(name, blob) {
  const link = make("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1e4);
}

// How a parameter is distributed in the study, within its slider; nothing without a study.
function density(counts) {
  const bars = make("div", { class: "fx-density", "aria-hidden": "true" });
  if (!counts) return bars;
  const most = Math.max(...counts, 1);
  bars.append(...counts.map((n) => make("i", { style: `height:${(100 * n) / most}%` })));
  return bars;
}

window.fascicleExplorer = (element, send) => {
  if (!hasWebGL(element)) return null;
  return new Explorer(element, send);
};

// The page of `fascicle explore`: one socket; where it ends the page says so.
const page = document.querySelector("[data-fascicle-explorer]");
if (page) {
  const socket = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws")));
  socket.binaryType = "arraybuffer";
  const explorer = window.fascicleExplorer(page, (message) => socket.send(JSON.stringify(message)));
  socket.onmessage = (event) => explorer?.heard(event.data);
  socket.onclose = () => {
    page.prepend(make("p", { role: "alert", class: "fx-ended" },
      "The explorer has ended; start it again with “fascicle explore”."));
  };
  window.explorer = explorer;
}
