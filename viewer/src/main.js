// The heart of a report: scenarios in the networks of a population, with the ECG, in one time.

import { BullsEye } from "./bullseye.js";
import { ColourBar, ZERO } from "./colours.js";
import { addStyle, button, check, choice, hasWebGL, make } from "./controls.js";
import { potentials } from "./data.js";
import { EcgPaper } from "./ecg.js";
import { Panel } from "./panel.js";
import { Player } from "./player.js";
import "./explorer.js";

const PLAYED_IN = 5; // seconds
const RECORDED = "#1a1a1a";
const SIMULATED = ["#d55e00", "#0072b2"]; // of the scenario, and of the one it is compared with

class Viewer {
  constructor(element, data) {
    this.data = data;
    this.scenarios = [0, null];
    this.network = data.median;
    this.field = 0;
    this.picked = null;
    this.start = data.ecg.start;
    this.end = this.start + data.ecg.step * (data.ecg.count - 1);
    this.time = this.end;
    addStyle();
    this.build(element);
    this.panels = [];
    this.addPanel();
    this.order(0);
    this.show();
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.whenDark = () => this.drawColours();
    this.dark.addEventListener("change", this.whenDark);
  }

  build(element) {
    const { data } = this;
    const titles = data.scenarios.map(({ title }) => title);
    this.scenarioChoice = choice("scenario", titles, (k) => this.chooseScenario(k));
    this.otherChoice = choice("compare with", ["nothing", ...titles], (k) => this.compare(k - 1));
    const fields = data.scenarios[0].fields.map(({ label }) => label);
    this.fieldChoice = choice("shown", ["activation of one network", ...fields], (k) =>
      this.chooseField(k),
    );
    const orders = data.orders.map(({ label, unit }) => (unit === "1" ? label : `${label} (${unit})`));
    const order = choice("ordered by", orders, (k) => this.order(k));
    const last = data.networks.length - 1;
    this.networkSlider = make("input", { type: "range", min: 0, max: last, "aria-label": "network" });
    this.networkSlider.addEventListener("input", () => {
      this.network = this.ranked[Number(this.networkSlider.value)];
      this.show();
    });
    this.networkText = make("span", { class: "fv-clock" });
    this.slider = make("input", {
      type: "range", min: this.start, max: this.end, step: 0.5, "aria-label": `time (ms; 0: ${ZERO})`,
    });
    this.slider.addEventListener("input", () => this.moveTo(Number(this.slider.value)));
    this.player = new Player(this, PLAYED_IN);
    this.clock = make("span", { class: "fv-clock" });
    const looked = () => this.look();
    this.cut = make("input", { type: "range", min: 0, max: 95, value: 0, "aria-label": "cut" });
    this.cut.addEventListener("input", looked);
    this.opaque = check("opaque", false, looked);
    this.only = check("endocardia only", false, looked);
    this.networks = check("Purkinje network", true, looked);
    this.labelled = check("isochrones in ms", true, looked);
    this.early = choice("colours", ["early is bright", "early is red"], looked);
    this.read = make("span", { "aria-live": "polite" });
    this.bar = new ColourBar();
    this.pictures = make("div", { class: "fv-pictures" });
    this.views = make("div", { class: "fv-row" });
    const paper = make("div", { class: "fv-ecg" });
    this.segments = make("div", { class: "fv-row fv-keep" });
    const scarred = data.surfaces[0].scarred ? ["Hatched: scar."] : [];
    this.root = make(
      "div", { class: "fv" },
      make("div", { class: "fv-row" }, this.scenarioChoice.row, this.otherChoice.row,
        this.fieldChoice.row, this.early.row),
      make("div", { class: "fv-both" }, make("div", { class: "fv-left" }, this.pictures, this.views,
        make("div", { class: "fv-row" }, this.networks.row, this.opaque.row, this.only.row,
          this.labelled.row, make("label", {}, "cut", this.cut)), this.segments), paper),
      make("div", { class: "fv-row" }, this.player.button, this.slider, this.clock),
      make("div", { class: "fv-row fv-keep" }, this.bar.canvas, this.bar.text, ...scarred),
      make("div", { class: "fv-row" }, make("label", { class: "fv-long" }, "network",
        this.networkSlider), this.networkText, order.row),
      make("div", { class: "fv-row fv-keep fv-read" }, this.read),
    );
    element.replaceChildren(this.root);
    this.ecg = new EcgPaper(paper);
    this.ecg.onCursor = (time) => {
      this.player.stop();
      this.moveTo(time);
    };
  }

  addPanel() {
    const panel = new Panel(this.data);
    this.panels.push(panel);
    this.pictures.append(panel.root);
    this.segments.append(panel.bullsEye.root);
    panel.stage.onClick = (ray) => this.pick(ray, panel);
    panel.stage.onTurn = () =>
      this.panels.filter((other) => other !== panel).forEach(({ stage }) => stage.follow(panel.stage));
    if (this.panels.length === 1) {
      this.views.replaceChildren(
        ...Object.keys(panel.stage.views).map((name) =>
          button(name, `view: ${name}`, () => panel.stage.view(name)),
        ),
      );
    } else panel.stage.follow(this.panels[0].stage);
  }

  get stage() {
    return this.panels[0].stage;
  }

  chooseScenario(k) {
    this.scenarios[0] = k;
    this.show();
  }

  // Shows another scenario beside the first; -1 none.
  compare(k) {
    this.scenarios[1] = k < 0 ? null : k;
    if (k < 0) this.panels.splice(1).forEach((panel) => panel.dispose());
    else if (this.panels.length === 1) this.addPanel();
    this.root.classList.toggle("fv-two", this.panels.length === 2);
    this.show();
  }

  chooseField(k) {
    this.field = k;
    this.player.stop();
    this.time = this.end;
    this.show();
  }

  // Puts the networks into the order of a quantity; the one that is shown stays.
  order(k) {
    const { values } = (this.ordered = this.data.orders[k]);
    this.ranked = values.map((_, n) => n).sort((a, b) => values[a] - values[b]);
    this.nameNetwork();
  }

  nameNetwork() {
    const { label, unit, values, words } = this.ordered;
    const rank = this.ranked.indexOf(this.network);
    this.networkSlider.value = String(rank);
    const value = values[this.network];
    const said = words?.[value] ?? `${value}${unit === "1" ? "" : ` ${unit}`}`;
    this.networkText.textContent = `${rank + 1} of ${values.length}: ${label} ${said}`;
    this.networkSlider.setAttribute("aria-valuetext", this.networkText.textContent);
  }

  // What is shown of a scenario: a map over all networks, or undefined for one of them.
  fieldOf(scenario) {
    return scenario.fields[this.field - 1];
  }

  get shown() {
    const { top } = this.data.times;
    const one = { name: "activation", label: "activation", unit: "ms", kind: "time", low: 0, high: top };
    return this.fieldOf(this.data.scenarios[this.scenarios[0]]) ?? one;
  }

  show() {
    this.panels.forEach((panel, k) => {
      const scenario = this.data.scenarios[this.scenarios[k]];
      panel.show(scenario, this.network, this.fieldOf(scenario));
    });
    this.slider.disabled = this.player.button.disabled = this.shown.kind !== "time";
    this.nameNetwork();
    this.look();
    this.showEcg();
    this.moveTo(this.time);
    this.readPicked();
  }

  look() {
    const early = ["time", "red"][Number(this.early.select.value)];
    const look = {
      opaque: this.opaque.box.checked, only: this.only.box.checked, early,
      networks: this.networks.box.checked, labelled: this.labelled.box.checked,
      cut: Number(this.cut.value) / 100,
    };
    this.panels.forEach((panel) => panel.look(look));
    this.drawColours();
  }

  // What is coloured besides the hearts.
  drawColours() {
    const field = this.shown;
    const kind = field.kind === "time" ? this.panels[0].heart.early : field.kind;
    const ink = getComputedStyle(this.root).color;
    this.bar.show(field, kind, ink);
    this.panels.forEach(({ bullsEye, scenario }) => {
      const { one, all } = scenario.segments;
      const shown = this.field ? all[this.field - 1] : { values: one[this.network] };
      bullsEye.show(shown, { ...field, kind }, scenario.title, ink);
    });
  }

  showEcg() {
    const { data } = this;
    const { leads, start, step } = data.ecg;
    const simulated = this.panels.map(({ scenario }, k) => ({
      name: k || this.panels.length > 1 ? `simulated, ${scenario.title}` : "simulated",
      colour: SIMULATED[k], dashed: k === 1, values: potentials(scenario.ecgs[this.network], leads),
    }));
    const recorded = data.recorded ? [this.recordedTrace()] : [];
    this.ecg.show({ leads, start, step, zero: ZERO, traces: [...recorded, ...simulated] });
  }

  // The recorded beat where the fit puts it under the simulated one of this network.
  recordedTrace() {
    const { recorded, ecg, scenarios } = this.data;
    const first = ecg.start - recorded.begins[this.network];
    const all = potentials(recorded.values, recorded.leads);
    const values = {};
    for (const [lead, each] of Object.entries(all)) {
      values[lead] = Float32Array.from(
        { length: ecg.count }, (_, n) => each[Math.round(first + n * ecg.step)] ?? NaN,
      );
    }
    const its = scenarios.find(({ name }) => name === recorded.scenario);
    const same = its === this.panels[0].scenario && this.panels.length === 1;
    return { name: same ? "recorded" : `recorded, ${its.title}`, colour: RECORDED, values };
  }

  moveTo(time) {
    this.time = time;
    this.slider.value = String(time);
    const said = time >= this.end ? "whole beat" : `${Math.round(time)} ms`;
    this.clock.textContent = this.shown.kind === "time" ? said : "";
    this.slider.setAttribute("aria-valuetext", said);
    this.panels.forEach((panel) => panel.at(time, this.end));
    this.ecg.cursor(time);
  }

  // Value where a ray meets the heart; null beside it.
  pick(ray, panel = this.panels[0]) {
    const vertex = panel.pick(ray);
    this.panels.forEach((other) => {
      if (other === panel) return;
      other.marker.visible = panel.marker.visible;
      other.marker.position.copy(panel.marker.position);
      other.picked = vertex;
    });
    this.picked = vertex;
    this.readPicked();
    return vertex === null ? null : panel.heart.valueAt(vertex);
  }

  // Writes the values at the place that was picked.
  readPicked() {
    if (this.picked === null) {
      this.read.textContent = "Click on the heart for a value.";
      return;
    }
    const said = this.panels.map(({ heart, scenario }) =>
      `${this.written(heart.valueAt(this.picked))} — ${this.shown.label}, ${scenario.title}`);
    this.read.textContent = said.join("; ");
  }

  written(value) {
    if (Number.isNaN(value)) return "never activated";
    const { unit } = this.shown;
    return unit === "1" ? value.toFixed(2) : `${value.toFixed(0)} ${unit}`;
  }

  state() {
    return {
      scenario: this.data.scenarios[this.scenarios[0]].name,
      field: this.shown.name,
      network: this.data.networks[this.network],
      time: this.time,
      playing: this.player.playing,
      camera: this.stage.camera.position.toArray(),
    };
  }

  dispose() {
    this.player.stop();
    this.dark.removeEventListener("change", this.whenDark);
    this.ecg.dispose();
    this.panels.forEach((panel) => panel.dispose());
    this.root.remove();
  }
}

window.fascicleViewer = (element, data) => {
  if (!hasWebGL(element)) return null;
  return new Viewer(element, data);
};
