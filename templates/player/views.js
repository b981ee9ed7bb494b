/* Views of a motion: the body itself, phase plane, curves over time, bars of energy, section. */

/* Each kind gives the places of points for a state: flat, dim numbers a point. */
const SCENES = {
  pendulum: ({ angles, lengths }, { parameters }) => ({
    rods: angles.map((_, k) => [k, k + 1]),
    traced: [angles.length],
    pivots: [0],
    places(z) {
      const found = [[0, 0]];
      angles.forEach((i, k) => {
        const length = typeof lengths[k] === "number" ? lengths[k] : parameters[lengths[k]];
        const [x, y] = found[k];
        found.push([x + length * Math.sin(z[i]), y - length * Math.cos(z[i])]);
      });
      return found;
    },
  }),
  polar: ({ pairs, zero, rods }) => ({
    rods: rods ? pairs.map((_, k) => [0, k + 1]) : [],
    traced: pairs.map((_, k) => k + 1),
    pivots: [0],
    places: (z) => [
      [0, 0],
      ...pairs.map(([i, j]) => [z[i] * Math.cos(z[j] + zero), z[i] * Math.sin(z[j] + zero)]),
    ],
  }),
  plane: ({ bodies }) => ({
    rods: [],
    traced: bodies.map((_, k) => k),
    pivots: [],
    places: (z) => bodies.map(([i, j]) => [z[i], z[j]]),
  }),
  // Seen from above the horizon; the arrow keys and dragging turn the space.
  space: ({ bodies }, { view }) => ({
    rods: [],
    traced: bodies.map((_, k) => k),
    pivots: [],
    places: (z) =>
      bodies.map(([i, j, k]) => {
        const x = z[i] * Math.cos(view.turn) - z[j] * Math.sin(view.turn);
        const y = z[i] * Math.sin(view.turn) + z[j] * Math.cos(view.turn);
        return [x, z[k] * Math.cos(view.tilt) + y * Math.sin(view.tilt)];
      }),
  }),
  chain: ({ coordinates }) => ({
    rods: coordinates.slice(1).map((_, k) => [k, k + 1]),
    traced: [],
    pivots: [],
    places: (z) => coordinates.map((i, k) => [k + 1, z[i]]),
  }),
  potential: (_, { potential }) => ({
    rods: [],
    traced: [],
    pivots: [],
    places: (z, t) => [[z[0], potential(z, t)]],
  }),
};

const COLOURS = ["c0", "c1", "c2", "c3", "c4", "c5"];
const colour = (k) => COLOURS[k % COLOURS.length];
const ENERGY_COLOURS = { kinetic: "c1", potential: "c2", energy: "c0" };

// -- views -----------------------------------------------------------------------------------------

/** The body itself. */
class MotionView {
  constructor(player, canvas) {
    this.player = player;
    this.plot = new Plot(canvas);
    const turn = (across, up) => {
      const { view } = player;
      view.turn += across;
      view.tilt = Math.min(Math.max(view.tilt + up, -Math.PI / 2), Math.PI / 2);
      this.draw();
      this.move();
    };
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons && player.problem.scene.kind === "space") turn(event.movementX / 100, event.movementY / 100);
    });
    canvas.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (!way || player.problem.scene.kind !== "space") return;
      event.preventDefault();
      turn(...way);
    });
  }

  draw() {
    const { player, plot } = this, { problem, samples } = player, { kind } = problem.scene;
    const scene = (this.scene = SCENES[kind](problem.scene, player));
    const stride = Math.max(1, Math.floor(samples.count / 800));
    const places = (this.places = []);
    for (let k = 0; k < samples.count; k += stride) {
      places.push(scene.places(samples.z.subarray(k * samples.dim, (k + 1) * samples.dim), samples.t[k]));
    }
    this.stride = stride;
    const ends = (k) => range(places.flat().map((place) => place[k]), 0.1, player.limits[0]);
    const box = [...(kind === "chain" ? [0.5, problem.dof + 0.5] : ends(0)), ...ends(1)];
    if (kind === "pendulum") {
      const reach = 1.12 * Math.max(...places[0].map((_, k) => Math.hypot(...this.span(places, k))), 1e-300);
      box.splice(0, 4, -reach, reach, -reach, reach);
    }
    if (kind === "potential") this.drawPotential(box);
    else {
      const axes = kind === "plane" || kind === "chain";
      plot.begin(box, { equal: kind !== "chain", axes });
      if (axes) plot.axes(...problem.scene.axes);
      plot.inside(plot.back, (context) => {
        if (problem.dof === 2 && kind === "plane" && problem.natural && !problem.timed) this.drawBoundary(context);
        if (kind === "space") this.drawDirections(context);
        if (samples.count * scene.traced.length > 20_000) return;
        for (const body of scene.traced) {
          const [x, y] = [0, 1].map((k) => (n) => places[n][body][k]);
          context.globalAlpha = 0.35;
          plot.curve(context, 0, places.length - 1, x, y, colour(scene.traced.indexOf(body)), 1);
          context.globalAlpha = 1;
        }
      });
    }
  }

  /** The directions of x, y and z from the origin. */
  drawDirections(context) {
    const { plot, player } = this, [i, j, k] = player.problem.scene.bodies[0], length = 0.2 * (plot.box[3] - plot.box[2]);
    for (const place of [i, j, k]) {
      const z = new Float64Array(player.samples.dim);
      z[place] = length;
      const end = this.scene.places(z)[0];
      plot.curve(context, 0, 1, (n) => n * end[0], (n) => n * end[1], "dim", 1);
      context.fillStyle = plot.colour("dim");
      write(context, player.problem.labels[place], plot.X(end[0]) + 3, plot.Y(end[1]) - 3);
    }
  }

  span(places, point) {
    return [0, 1].map((k) => Math.max(...places.map((place) => Math.abs(place[point][k]))));
  }

  /** Where the potential equals the energy. */
  drawBoundary(context) {
    const { plot, player } = this, z = new Float64Array(4), { bodies } = player.problem.scene;
    const level = player.energies.energy[0], t = player.samples.t[0];
    const height = (x, y) => {
      z[bodies[0][0]] = x;
      z[bodies[0][1]] = y;
      return player.potential(z, t);
    };
    context.strokeStyle = plot.colour("dim");
    context.setLineDash([4, 4]);
    strokeSegments(plot, context, contour(grid(height, plot.box), level));
    context.setLineDash([]);
  }

  drawPotential(box) {
    const { plot, player } = this, { energies, problem } = player;
    const wide = (box[1] - box[0]) * 0.25;
    const left = box[0] - wide, right = box[1] + wide;
    const z = new Float64Array(2), n = 160;
    this.height = (x, t) => {
      z[0] = x;
      return player.potential(z, t);
    };
    this.at = (k) => left + ((right - left) * k) / n;
    const heights = Array.from({ length: n + 1 }, (_, k) => this.height(this.at(k), player.samples.t[0]));
    const [low, high] = range([...energies.energy, ...energies.potential], 0.15);
    const top = Math.max(high, Math.min(Math.max(...heights.filter(Number.isFinite), high), high + (high - low)));
    plot.begin([left, right, low, top]).axes(problem.labels[0], { base: "energy" });
    if (!problem.timed) {
      plot.inside(plot.back, (context) => {
        plot.curve(context, 0, n, this.at, (k) => heights[k], ENERGY_COLOURS.potential);
      });
      plot.legend([[{ base: "V" }, ENERGY_COLOURS.potential], [{ base: "H" }, ENERGY_COLOURS.energy]]);
    }
  }

  move() {
    const { plot, scene, player } = this, { kind } = player.problem.scene, { z, t, samples } = player;
    const places = scene.places(z, t);
    plot.inside(plot.frame(), (context) => {
      if (kind === "potential") {
        if (player.problem.timed) plot.curve(context, 0, 160, this.at, (k) => this.height(this.at(k), t), "c2");
        const energy = player.system.energy(z, t, player.parameters);
        plot.curve(context, 0, 1, (k) => plot.box[k], () => energy, ENERGY_COLOURS.energy, 1);
      }
      const now = player.sampleAt(t), tail = player.sampleAt(t - 0.12 * (player.span[1] - player.span[0]));
      for (const body of scene.traced) {
        const first = Math.min(Math.ceil(tail / this.stride), this.places.length - 1);
        const last = Math.min(Math.floor(now / this.stride), this.places.length - 1);
        const path = this.places.slice(first, last + 1).map((all) => all[body]);
        path.push(places[body]);
        plot.curve(context, 0, path.length - 1, (k) => path[k][0], (k) => path[k][1], colour(scene.traced.indexOf(body)), 2.5);
      }
      context.lineCap = "round";
      for (const [one, other] of scene.rods) {
        const ends = [places[one], places[other]];
        plot.curve(context, 0, 1, (k) => ends[k][0], (k) => ends[k][1], "text", 2);
      }
      places.forEach(([x, y], k) => {
        if (scene.pivots.includes(k)) plot.dot(context, x, y, "text", 3);
        else plot.dot(context, x, y, colour(scene.traced.length > 1 ? scene.traced.indexOf(k) : 0), places.length > 12 ? 4 : 7);
      });
    });
  }
}

function strokeSegments(plot, context, segments) {
  context.lineWidth = 1;
  context.beginPath();
  for (const [[a, b], [c, d]] of segments) {
    context.moveTo(plot.X(a), plot.Y(b));
    context.lineTo(plot.X(c), plot.Y(d));
  }
  context.stroke();
}

/** The plane of two components, in which a click is a new start. */
class PhaseView {
  constructor(player, canvas) {
    this.player = player;
    this.plot = new Plot(canvas);
    const start = (x, y) => player.setStart([[this.x, x], [this.y, y]]);
    canvas.addEventListener("pointerdown", (event) => start(...this.plot.at(event)));
    canvas.addEventListener("pointermove", (event) => event.buttons && start(...this.plot.at(event)));
    canvas.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!way) return;
      event.preventDefault();
      const [left, right, bottom, top] = this.plot.box, { start: now } = player;
      start(now[this.x] + (way[0] * (right - left)) / 60, now[this.y] + (way[1] * (top - bottom)) / 60);
    });
  }

  draw() {
    const { player, plot } = this, { samples, problem, limits } = player, { dim, z } = samples;
    [this.x, this.y] = player.plane;
    const column = (i) => (k) => z[k * dim + i];
    const ends = [this.x, this.y].flatMap((i) =>
      range(Array.from({ length: samples.count }, (_, k) => z[k * dim + i]), 0.2, limits[i < dim / 2 ? 0 : 1]),
    );
    plot.begin(ends).axes(problem.labels[this.x], problem.labels[this.y]);
    plot.inside(plot.back, (context) => {
      if (problem.dof === 1) this.drawLevels(context);
      plot.curve(context, 0, samples.count - 1, column(this.x), column(this.y), "c0", 1.5);
      plot.dot(context, player.start[this.x], player.start[this.y], "c1", 5);
    });
    plot.legend([[{ base: "start" }, "c1"]], plot.width - 60);
  }

  drawLevels(context) {
    const { plot, player } = this, z = new Float64Array(2), t = player.samples.t[0];
    const surface = grid((x, y) => {
      z[0] = x;
      z[1] = y;
      return player.system.energy(z, t, player.parameters);
    }, plot.box);
    const known = surface.values.flatMap((row) => Array.from(row)).filter(Number.isFinite).sort((a, b) => a - b);
    context.strokeStyle = plot.colour("level");
    for (let k = 0; k < 12 && known.length; k++) {
      const level = known[Math.floor((0.02 + (0.96 * k) / 11) * (known.length - 1))];
      strokeSegments(plot, context, contour(surface, level));
    }
  }

  move() {
    const { plot, player } = this;
    plot.inside(plot.frame(), (context) => plot.dot(context, player.z[this.x], player.z[this.y], "c0", 6));
  }
}

/** Curves over time. */
class TimeView {
  constructor(player, canvas, curves) {
    Object.assign(this, { player, curves, plot: new Plot(canvas) });
  }

  draw() {
    const { player, plot } = this, { samples } = player;
    const { names, axis, limit } = this.curves(player);
    const values = names.map(([, , value]) => Array.from({ length: samples.count }, (_, k) => value(k)));
    const span = [...player.span].sort((a, b) => a - b);
    plot.begin([...span, ...range(values.flat(), 0.06, limit)]).axes({ base: "t", unit: player.problem.time_unit }, axis);
    plot.inside(plot.back, (context) => {
      values.forEach((of, n) => plot.curve(context, 0, samples.count - 1, (k) => samples.t[k], (k) => of[k], names[n][1]));
    });
    plot.legend(names);
  }

  move() {
    const { plot, player } = this, context = plot.frame();
    plot.curve(context, 0, 1, () => player.t, (k) => plot.box[2 + k], "dim", 1);
  }
}

/** Energies at the present time, as bars. */
class BarView {
  constructor(player, canvas) {
    Object.assign(this, { player, plot: new Plot(canvas) });
  }

  draw() {
    const { player, plot } = this;
    this.names = player.problem.natural ? ["kinetic", "potential", "energy"] : ["energy"];
    const all = this.names.flatMap((name) => Array.from(player.energies[name]));
    plot.begin([0, this.names.length, ...range([0, ...all], 0.06)], { axes: false });
    plot.sides = { ...plot.sides, bottom: 10 };
    plot.curve(plot.back, 0, 1, (k) => k * this.names.length, () => 0, "dim", 1);
  }

  move() {
    const { plot, player } = this, context = plot.frame(), { z, t } = player;
    const energy = player.system.energy(z, t, player.parameters), potential = player.potential(z, t);
    const values = { kinetic: energy - potential, potential, energy };
    this.names.forEach((name, k) => {
      const foot = plot.Y(0), head = plot.Y(values[name]);
      context.fillStyle = plot.colour(ENERGY_COLOURS[name]);
      context.fillRect(plot.X(k + 0.15), Math.min(foot, head), plot.X(k + 0.85) - plot.X(k + 0.15), Math.max(Math.abs(head - foot), 1));
      context.fillStyle = plot.colour("text");
      const letter = { base: { kinetic: "T", potential: "V", energy: "H" }[name] };
      write(context, letter, plot.X(k + 0.5) - 5, values[name] < 0 ? foot - 4 : foot + 14 > plot.height ? foot - 4 : foot + 14);
    });
  }
}

/** Points at which a trajectory on a longer span crosses a surface, computed while it is drawn. */
class SectionView {
  constructor(player, canvas, note) {
    Object.assign(this, { player, note, plot: new Plot(canvas), points: [], running: 0 });
  }

  /** Begin with the present values. */
  restart() {
    const { player } = this, { samples, problem } = player, [start, end] = player.span;
    const second = Float64Array.from({ length: samples.count }, (_, k) => samples.z[k * 4 + 1]);
    const low = Math.min(...second), high = Math.max(...second);
    this.level = low < 0 && high > 0 ? 0 : (low + high) / 2;
    this.points = [];
    this.trajectory = new Trajectory(player.field, player.start, [start, start + 60 * (end - start)], problem.method, 1e-9);
    this.name = `${problem.names[1]} = ${short(this.level)}, rising`;
    clearTimeout(this.running);
    this.running = setTimeout(() => this.work(), 120);
  }

  /** Some milliseconds of work; the rest later. */
  work() {
    const { trajectory, player } = this, until = performance.now() + 6, state = new Float64Array(4);
    while (!trajectory.done && this.points.length < 1_500 && performance.now() < until) {
      trajectory.advance(4);
      for (const step of trajectory.steps) this.collect(step, state);
      trajectory.steps.length = 0;
      if (trajectory.z.some((value, i) => !(Math.abs(value) < player.limits[i < 2 ? 0 : 1]))) {
        trajectory.reason = "it escapes";
      }
    }
    this.draw();
    if (!trajectory.done && this.points.length < 1_500) this.running = setTimeout(() => this.work(), 12);
  }

  collect(step, state) {
    const above = (share) => this.trajectory.within(step, share, state)[1] - this.level;
    for (let part = 0, before = above(0); part < 4; part++) {
      const after = above((part + 1) / 4);
      if (before < 0 && after >= 0) {
        let low = part / 4, high = (part + 1) / 4;
        for (let k = 0; k < 40; k++) {
          const middle = (low + high) / 2;
          if (above(middle) < 0) low = middle;
          else high = middle;
        }
        above(high);
        this.points.push([state[0], state[2]]);
      }
      before = after;
    }
  }

  draw() {
    const { plot, player, points } = this, { labels } = player.problem;
    const ends = [0, 1].flatMap((k) => range(points.length ? points.map((point) => point[k]) : [player.start[2 * k]], 0.1));
    plot.begin(ends).axes(labels[0], labels[2]);
    plot.inside(plot.back, (context) => {
      context.fillStyle = plot.colour("c0");
      for (const [x, y] of points) context.fillRect(plot.X(x) - 1.2, plot.Y(y) - 1.2, 2.4, 2.4);
    });
    plot.frame();
    const { reason } = this.trajectory;
    this.note.textContent = `${points.length} crossings of ${this.name}${reason && `; ends at t = ${short(this.trajectory.t)}, ${reason}`}`;
  }

  move() {}
}
