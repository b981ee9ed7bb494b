/* The player of a page: it takes a system and its values, integrates, and moves the views.

   `new Player(element, changed).load(system, problem)`, where the element has the parts of
   player.html.jinja, `system` is a module that hamsym generates for JavaScript, and `problem` is what
   hamsym.workbench.lessons.problem writes. `changed` is told of new values. */

const WHILE_MOVING = 1e-8; // tolerance of steps while a slider moves; pictures show no difference
const POSITIONS = 400; // of a slider, whole numbers: browsers count in decimals

/** A typed number, which may be a multiple of pi such as 3*pi/4; NaN if it is none. */
function numberIn(text) {
  const multiple = /^\s*(-?)(?:([\d.]+)\s*\*\s*)?pi(?:\s*\/\s*([\d.]+))?\s*$/.exec(text);
  if (!multiple) return text.trim() === "" ? NaN : Number(text);
  const [, sign, factor = 1, divisor = 1] = multiple;
  return ((sign ? -1 : 1) * Number(factor) * Math.PI) / Number(divisor);
}

export class Player {
  constructor(root, changed = () => {}) {
    Object.assign(this, { root, changed, view: { turn: 0.6, tilt: 0.45 }, playing: false, dirty: false });
    this.part = (name) => root.querySelector(`[data-part="${name}"]`);
    this.part("play").addEventListener("click", () => this.play(!this.playing));
    this.part("time").addEventListener("input", (event) => {
      this.play(false);
      this.seek(this.span[0] + ((this.span[1] - this.span[0]) * event.target.value) / 1000);
    });
    this.part("plane").addEventListener("change", () => this.redraw());
    this.part("reset").addEventListener("click", () => this.reset());
    root.querySelector("form").addEventListener("submit", (event) => event.preventDefault());
    new ResizeObserver(() => this.redraw()).observe(root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    for (const [event, printed] of [["beforeprint", true], ["afterprint", false]]) {
      addEventListener(event, () => {
        document.documentElement.toggleAttribute("data-printed", printed);
        if (this.problem) this.drawAll();
      });
    }
  }

  /** Take a system and its problem, with values from the address if it has them. */
  load(system, problem, given = {}) {
    const first = !this.problem;
    Object.assign(this, { system, problem });
    this.field = (z, t, out) => system.vector_field(z, t, this.parameters, out);
    this.rest = new Float64Array(2 * problem.dof);
    this.potential = (z, t) => {
      this.rest.set(z.subarray(0, problem.dof));
      return system.energy(this.rest, t, this.parameters);
    };
    this.take({});
    this.compare();
    this.take(given);
    this.fillPlanes();
    this.buildSliders();
    this.buildViews();
    this.part("section").hidden = problem.dof !== 2;
    this.part("section").parentElement.classList.toggle("four", problem.dof === 2);
    this.t = this.span[0];
    this.change();
    if (first) this.play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    return this;
  }

  /** Set values by name; those that are not given are the problem's. */
  take(given) {
    const { problem } = this;
    const value = (name, usual) => (name in given && Number.isFinite(given[name]) ? given[name] : usual);
    this.start = Float64Array.from(problem.z0, (usual, i) => value(problem.names[i], usual));
    this.parameters = {};
    for (const { name, key, value: usual } of problem.parameters) this.parameters[key] = value(name, usual);
    const length = value("time span", problem.span[1] - problem.span[0]);
    this.span = [problem.span[0], problem.span[0] + (length || problem.span[1] - problem.span[0])];
  }

  /** The present values by name. */
  get values() {
    const { problem } = this;
    return {
      ...Object.fromEntries(problem.names.map((name, i) => [name, this.start[i]])),
      ...Object.fromEntries(problem.parameters.map(({ name, key }) => [name, this.parameters[key]])),
      "time span": this.span[1] - this.span[0],
    };
  }

  /** Print how far the page's trajectory is from that of hamsym.solve at the problem's values. */
  compare() {
    const { reference } = this.problem;
    const difference = reference ? largestDifference(this.solved(), reference) : Infinity;
    this.root.dataset.difference = difference;
    this.part("accuracy").textContent = Number.isFinite(difference)
      ? `Accuracy: at the values of the start, this page differs from hamsym.solve by at most ${small(difference)} ` +
        `of the largest value of each component (estimated error of solve: ${minus(reference.error)}).`
      : "Accuracy: not known, since hamsym.solve or this page does not reach the end of the motion.";
  }

  solved(tolerance = TOLERANCE) {
    return new Trajectory(this.field, this.start, this.span, this.problem.method, tolerance).advance(MOST_STEPS + 1);
  }

  // -- elements --------------------------------------------------------------------------------

  fillPlanes() {
    const { names, dof, plane } = this.problem, box = this.part("plane");
    const pairs = Array.from({ length: dof }, (_, k) => [k, k + dof]);
    for (let k = 0; k + 1 < Math.min(dof, 12); k++) pairs.push([k, k + 1]);
    box.replaceChildren(...pairs.map(([x, y]) => new Option(`${names[x]}, ${names[y]}`, `${x},${y}`)));
    box.value = plane.join();
    box.parentElement.hidden = pairs.length < 2;
  }

  get plane() {
    return this.part("plane").value.split(",").map(Number);
  }

  buildSliders() {
    const { problem } = this, of = (name, list) => this.part(name).replaceChildren(...list);
    this.sliders = [];
    of("starts", problem.names.map((name, i) =>
      this.slider(name, problem.labels[i], problem.starts[i], () => this.start[i], (value) => (this.start[i] = value))));
    of("parameters", problem.parameters.filter(({ range }) => range).map(({ name, key, label, range }) =>
      this.slider(name, label, range, () => this.parameters[key], (value) => (this.parameters[key] = value))));
    const [low, high] = [0.05, 4].map((factor) => factor * (problem.span[1] - problem.span[0]));
    of("span", [this.slider("time span", { base: "time span", unit: problem.time_unit }, [low, high],
      () => this.span[1] - this.span[0], (value) => (this.span[1] = this.span[0] + (value || high / 4)))]);
    this.part("parameters").closest("fieldset").hidden = !this.part("parameters").children.length;
  }

  slider(name, { base, sub, unit }, [low, high], get, set) {
    const row = document.createElement("div"), label = document.createElement("label");
    const letter = document.createElement("i"), slider = document.createElement("input"), field = document.createElement("input");
    row.className = "slider";
    letter.textContent = base;
    if (sub) letter.append(Object.assign(document.createElement("sub"), { textContent: sub }));
    label.append(letter, unit ? ` / ${unit}` : "");
    Object.assign(slider, { type: "range", min: 0, max: POSITIONS, id: `slider-${name.replace(" ", "-")}` });
    label.htmlFor = slider.id;
    slider.setAttribute("aria-label", name); // the name as it is typed
    Object.assign(field, { type: "text", inputMode: "decimal", autocomplete: "off" });
    field.setAttribute("aria-label", `value of ${name}`);
    const show = () => {
      slider.value = Math.round(((get() - low) / (high - low)) * POSITIONS);
      slider.setAttribute("aria-valuetext", `${name} = ${short(get())}`);
      if (document.activeElement !== field) field.value = typed(get());
    };
    slider.addEventListener("input", () => {
      set(Number((low + ((high - low) * slider.value) / POSITIONS).toPrecision(4)));
      this.change(WHILE_MOVING);
    });
    field.addEventListener("change", () => {
      const value = numberIn(field.value);
      field.setAttribute("aria-invalid", !Number.isFinite(value));
      if (!Number.isFinite(value)) return;
      set(value);
      this.change();
    });
    row.append(label, slider, field);
    this.sliders.push({ show });
    return row;
  }

  buildViews() {
    if (this.views) return;
    this.views = {
      motion: new MotionView(this, this.part("motion")),
      phase: new PhaseView(this, this.part("phase")),
      energies: new TimeView(this, this.part("energies"), ({ energies, problem }) => ({
        names: (problem.natural ? ["kinetic", "potential", "energy"] : ["energy"]).map((name) => [
          { base: { kinetic: "T", potential: "V", energy: "H" }[name] }, ENERGY_COLOURS[name], (k) => energies[name][k],
        ]),
        axis: { base: "energy", unit: problem.energy_unit },
      })),
      bars: new BarView(this, this.part("bars")),
      components: new TimeView(this, this.part("components"), ({ samples, problem, limits }) => ({
        names: problem.labels.slice(0, Math.min(problem.dof, 6)).map((label, i) => [
          label, colour(i), (k) => samples.z[k * samples.dim + i],
        ]),
        axis: { base: "", unit: problem.labels[0].unit },
        limit: limits[0],
      })),
      section: new SectionView(this, this.part("crossings"), this.part("crossings-note")),
    };
  }

  // -- values ----------------------------------------------------------------------------------

  setStart(pairs) {
    for (const [i, value] of pairs) if (Number.isFinite(value)) this.start[i] = Number(value.toPrecision(4));
    this.change();
  }

  reset() {
    this.take({});
    this.seek(this.span[0]);
    this.change();
  }

  /** Compute and draw in the next frame; moves of a slider in between count once. */
  change(tolerance = TOLERANCE) {
    for (const { show } of this.sliders) show();
    this.stale = true;
    this.tolerance = tolerance;
    this.redraw();
    clearTimeout(this.telling);
    this.telling = setTimeout(() => {
      if (this.tolerance !== TOLERANCE) this.change();
      else this.changed(this.values, this);
    }, 300);
  }

  redraw() {
    if (this.dirty || !this.problem) return;
    this.dirty = true;
    requestAnimationFrame(() => this.drawAll());
  }

  drawAll() {
    this.dirty = false;
    if (this.stale) this.compute();
    this.stale = false;
    for (const view of this.shown) view.draw();
    this.seek(this.t);
  }

  get shown() {
    const { section, ...rest } = this.views;
    return this.problem.dof === 2 ? [...Object.values(rest), section] : Object.values(rest);
  }

  compute() {
    const { dof, natural, conserved, names } = this.problem;
    this.trajectory = this.solved(this.tolerance);
    const samples = (this.samples = this.trajectory.samples()), { count, dim } = samples;
    const energy = new Float64Array(count), potential = new Float64Array(count), kinetic = new Float64Array(count);
    for (let k = 0; k < count; k++) {
      const z = samples.z.subarray(k * dim, (k + 1) * dim);
      energy[k] = this.system.energy(z, samples.t[k], this.parameters);
      if (natural) potential[k] = this.potential(z, samples.t[k]);
      kinetic[k] = energy[k] - potential[k];
    }
    this.energies = { energy, potential, kinetic };
    // Ten times the size of the first tenth of the motion is where pictures end.
    const tenth = this.sampleAt(this.span[0] + (this.span[1] - this.span[0]) / 10);
    this.limits = [0, 0];
    let beyond = -1, at = 0;
    for (let k = 0; k < count; k++) {
      for (let i = 0; i < dim; i++) {
        const half = i < dof ? 0 : 1, size = Math.abs(samples.z[k * dim + i]);
        if (k <= tenth) this.limits[half] = Math.max(this.limits[half], 10 * size);
        else if (beyond < 0 && !(size <= (this.limits[half] || Infinity))) [beyond, at] = [i, samples.t[k]];
      }
    }
    this.limits = this.limits.map((limit) => limit || Infinity);
    this.t = this.clamped(this.t);
    const { reason, t } = this.trajectory, said = [];
    if (reason) said.push(`The motion ends at t = ${short(t)}: ${reason}.`);
    if (beyond >= 0) said.push(`${names[beyond]} leaves the pictures at t = ${short(at)}: they end at ten times the size of the start.`);
    if (conserved) {
      const size = Math.max(...energy.map(Math.abs), ...kinetic.map(Math.abs));
      const drift = Math.max(...energy.map((value) => Math.abs(value - energy[0]))) / (size || 1);
      said.push(`H is constant to ${small(drift)} of its size.`);
    }
    if (dof === 2) this.views.section.restart();
    this.part("status").textContent = said.join(" ");
    this.part("status").classList.toggle("bad", Boolean(reason) || beyond >= 0);
  }

  /** The number of the last sample up to a time. */
  sampleAt(t) {
    const { t: times, count } = this.samples, sign = Math.sign(this.span[1] - this.span[0]);
    let low = 0, high = count - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (sign * times[middle] <= sign * t) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  // -- time ------------------------------------------------------------------------------------

  clamped(t) {
    const end = this.trajectory ? this.trajectory.t : this.span[1], start = this.span[0];
    return Math.min(Math.max(t, Math.min(start, end)), Math.max(start, end));
  }

  /** Show a time. */
  seek(t) {
    this.t = this.clamped(t);
    if (!this.trajectory || this.stale) return;
    this.z = this.trajectory.state(this.t, this.z?.length === this.start.length ? this.z : new Float64Array(this.start.length));
    for (const view of this.shown) view.move();
    const scrubber = this.part("time"), share = (this.t - this.span[0]) / (this.span[1] - this.span[0]);
    scrubber.value = Math.round(1000 * share);
    const unit = unitOf(this.span), power = unit === 1 ? "" : unit.toExponential(0).slice(1).replace("+", "");
    this.part("now").textContent = minus(`t = ${(this.t / unit).toFixed(2)}${power}`);
    if (!this.playing) scrubber.setAttribute("aria-valuetext", `t = ${short(this.t)} of ${short(this.span[1])}`);
  }

  play(playing) {
    const began = !this.playing && playing;
    this.playing = playing;
    this.part("play").textContent = playing ? "Pause" : "Play";
    if (!began) return;
    if (this.trajectory && this.t === this.trajectory.t) this.t = this.span[0];
    let before = performance.now();
    const frame = (now) => {
      if (!this.playing) return;
      const length = this.span[1] - this.span[0];
      const rate = length / Math.min(Math.max(Math.abs(length), 8), 20);
      const step = rate * Number(this.part("speed").value) * Math.min(Math.max(now - before, 0), 100) / 1000;
      before = now;
      if (!this.stale) this.seek(this.t + step);
      if (this.trajectory && !this.stale && this.t === this.trajectory.t) this.play(false);
      else requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }
}

/** Keep values in the part of the address behind #, which reloading and sharing keep. */
export function keepInAddress(values) {
  const text = new URLSearchParams(Object.entries(values).map(([name, value]) => [name, String(value)])).toString();
  history.replaceState(null, "", `#${text}`);
}

/** Values by name from the address. */
export function fromAddress() {
  const given = new URLSearchParams(location.hash.slice(1));
  return Object.fromEntries([...given].filter(([, value]) => value.trim() !== "").map(([name, value]) => [name, Number(value)]));
}
