/* Plots on canvases: axes, curves and contours. */

const FONT = "12px system-ui, sans-serif";

/** Ends that contain values, with a margin; a constant gets some room. */
function range(values, margin = 0.06, limit = Infinity) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (!Number.isFinite(value)) continue;
    const shown = Math.min(Math.max(value, -limit), limit);
    low = Math.min(low, shown);
    high = Math.max(high, shown);
  }
  if (!(low <= high)) return [-1, 1];
  const largest = Math.max(Math.abs(low), Math.abs(high));
  const width = high - low > 1e-6 * largest ? high - low : largest || 1;
  const room = high - low > 1e-6 * largest ? margin * width : width / 2;
  return [low - room, high + room];
}

/** Multiples of 1, 2 or 5 times a power of ten, at most so many. */
function ticks([low, high], most) {
  const rough = (high - low) / Math.max(most, 1), power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough * (1 - 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k <= high / step + 1e-9; k++) found.push(k * step);
  return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

/** The power of ten in which numbers are written. */
function unitOf([low, high]) {
  const largest = Math.max(Math.abs(low), Math.abs(high));
  return largest < 1e-3 || largest >= 1e5 ? 10 ** (3 * Math.floor(Math.log10(largest) / 3)) : 1;
}

const minus = (text) => text.replaceAll("-", "−");
const short = (value) => minus(String(Number(value.toPrecision(4))));
/** A number as it is typed. */
const typed = (value) => {
  const rounded = Number(value.toPrecision(5)), size = Math.abs(rounded);
  return size >= 1e6 || (size > 0 && size < 1e-3) ? rounded.toExponential() : String(rounded);
};
const small = (value) => minus(value.toExponential(1));

/** Write a name: a letter, its index lower and smaller, and a unit; return its width. */
function write(context, { base, sub = "", unit = "" }, x, y) {
  const began = x;
  for (const [text, font, lower] of [
    [base, `italic ${FONT}`, 0],
    [sub, "italic 9px system-ui, sans-serif", 3],
    [unit && (base ? ` / ${unit}` : `in ${unit}`), FONT, 0],
  ]) {
    context.font = font;
    context.fillText(text, x, y + lower);
    x += context.measureText(text).width;
  }
  return x - began;
}

function widthOf(context, { base, sub = "", unit = "" }) {
  context.font = FONT;
  return context.measureText(base + sub + (unit && ` / ${unit}`)).width;
}

/** A canvas with axes: what moves is drawn on it, what stays on another one behind it. */
class Plot {
  constructor(canvas) {
    this.canvas = canvas;
    this.still = document.createElement("canvas");
    this.still.setAttribute("aria-hidden", "true");
    const layers = document.createElement("div");
    layers.className = "layers";
    canvas.replaceWith(layers);
    layers.append(this.still, canvas);
    this.front = canvas.getContext("2d");
    this.back = this.still.getContext("2d");
  }

  /** Take the present size and colours, and a box [left, right, bottom, top] of coordinates. */
  begin(box, { equal = false, axes = true } = {}) {
    const scale = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    const size = { width: Math.round(this.width * scale), height: Math.round(this.height * scale) };
    for (const canvas of [this.canvas, this.still]) {
      if (canvas.width !== size.width || canvas.height !== size.height) Object.assign(canvas, size);
    }
    for (const context of [this.front, this.back]) context.setTransform(scale, 0, 0, scale, 0, 0);
    const style = getComputedStyle(this.canvas);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim();
    this.sides = axes
      ? { left: 52, right: 16, top: 26, bottom: 38 }
      : { left: 10, right: 10, top: 10, bottom: 10 };
    const across = this.width - this.sides.left - this.sides.right;
    const up = this.height - this.sides.top - this.sides.bottom;
    let [left, right, bottom, top] = box;
    if (equal) {
      const unit = Math.max((right - left) / across, (top - bottom) / up);
      const x = (left + right) / 2, y = (bottom + top) / 2;
      [left, right, bottom, top] = [
        x - (unit * across) / 2, x + (unit * across) / 2, y - (unit * up) / 2, y + (unit * up) / 2,
      ];
    }
    this.box = [left, right, bottom, top];
    this.X = (x) => this.sides.left + ((x - left) / (right - left)) * across;
    this.Y = (y) => this.height - this.sides.bottom - ((y - bottom) / (top - bottom)) * up;
    this.back.clearRect(0, 0, this.width, this.height);
    return this;
  }

  /** The coordinates of a point of the screen. */
  at(event) {
    const [left, right, bottom, top] = this.box, { sides } = this;
    const place = this.canvas.getBoundingClientRect();
    const x = (event.clientX - place.left - sides.left) / (this.width - sides.left - sides.right);
    const y = (place.bottom - event.clientY - sides.bottom) / (this.height - sides.top - sides.bottom);
    return [left + x * (right - left), bottom + y * (top - bottom)];
  }

  axes(x, y) {
    const { back, sides, width, height } = this, [left, right, bottom, top] = this.box;
    back.lineWidth = 1;
    back.textBaseline = "alphabetic";
    const sidesOf = [
      [left, right, (width - sides.left - sides.right) / 50, x],
      [bottom, top, (height - sides.top - sides.bottom) / 34, y],
    ];
    for (const [k, [low, high, most, name]] of sidesOf.entries()) {
      const unit = unitOf([low, high]);
      const { found, digits } = ticks([low / unit, high / unit], most);
      for (const tick of found) {
        const place = k ? this.Y(tick * unit) : this.X(tick * unit);
        back.strokeStyle = this.colour("grid");
        back.beginPath();
        back.moveTo(k ? sides.left : place, k ? place : sides.top);
        back.lineTo(k ? width - sides.right : place, k ? place : height - sides.bottom);
        back.stroke();
        back.fillStyle = this.colour("dim");
        back.font = FONT;
        const text = minus(tick.toFixed(digits));
        const room = back.measureText(text).width;
        const at = Math.min(place - room / 2, width - room - 1);
        if (k) back.fillText(text, sides.left - 6 - room, place + 4);
        else back.fillText(text, at, height - sides.bottom + 15);
      }
      back.fillStyle = this.colour("text");
      const power = unit === 1 ? "" : unit.toExponential(0).replace("+", "");
      const shown = { ...name, unit: [power, name.unit].filter(Boolean).join(" ") };
      if (k) this.named = 18 + write(back, shown, 4, 14);
      else write(back, shown, width - sides.right - widthOf(back, shown), height - 6);
    }
    back.strokeStyle = this.colour("line");
    back.strokeRect(sides.left, sides.top, width - sides.left - sides.right, height - sides.top - sides.bottom);
  }

  /** Draw inside of the axes only. */
  inside(context, draw) {
    const { sides, width, height } = this;
    context.save();
    context.beginPath();
    context.rect(sides.left, sides.top, width - sides.left - sides.right, height - sides.top - sides.bottom);
    context.clip();
    draw(context);
    context.restore();
  }

  /** A curve through points from number `first` to `last`; gaps where they are not finite. */
  curve(context, first, last, x, y, colour, width = 1.5) {
    context.strokeStyle = this.colour(colour);
    context.lineWidth = width;
    context.lineJoin = "round";
    context.beginPath();
    let open = false;
    for (let k = first; k <= last; k++) {
      const px = this.X(x(k)), py = this.Y(y(k));
      if (!(Math.abs(px) < 1e6 && Math.abs(py) < 1e6)) open = false;
      else if (open) context.lineTo(px, py);
      else {
        context.moveTo(px, py);
        open = true;
      }
    }
    context.stroke();
  }

  dot(context, x, y, colour, radius = 6) {
    context.fillStyle = this.colour(colour);
    context.strokeStyle = this.colour("card");
    context.lineWidth = 1.5;
    context.beginPath();
    context.arc(this.X(x), this.Y(y), radius, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
  }

  /** Names of curves in their colours, above the axes. */
  legend(names, from = Math.max(this.named, this.sides.left + 12)) {
    let x = from;
    for (const [name, colour] of names) {
      this.back.fillStyle = this.colour(colour);
      if (x + widthOf(this.back, name) > this.width - 8) break;
      x += write(this.back, name, x, 14) + 14;
    }
  }

  /** Begin a frame. */
  frame() {
    this.front.clearRect(0, 0, this.width, this.height);
    return this.front;
  }
}

/** Values of a function of the plane on a grid. */
function grid(f, [left, right, bottom, top], nx = 56, ny = 44) {
  const values = [];
  for (let j = 0; j <= ny; j++) {
    const row = new Float64Array(nx + 1), y = bottom + ((top - bottom) * j) / ny;
    for (let i = 0; i <= nx; i++) row[i] = f(left + ((right - left) * i) / nx, y);
    values.push(row);
  }
  const place = (i, j) => [left + ((right - left) * i) / nx, bottom + ((top - bottom) * j) / ny];
  return { values, nx, ny, place };
}

/** Segments of the curve where a function on a grid has a value (marching squares). */
function contour({ values, nx, ny, place }, level) {
  const found = [];
  for (let j = 0; j < ny; j++) {
    for (let i = 0; i < nx; i++) {
      const corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
      const heights = corners.map(([a, b]) => values[b][a] - level);
      if (!heights.every(Number.isFinite)) continue;
      const cuts = [];
      for (let k = 0; k < 4; k++) {
        const one = heights[k], other = heights[(k + 1) % 4];
        if (one < 0 === other < 0) continue;
        const share = one / (one - other), [a, b] = corners[k], [c, d] = corners[(k + 1) % 4];
        cuts.push(place(a + share * (c - a), b + share * (d - b)));
      }
      for (let k = 0; k + 1 < cuts.length; k += 2) found.push([cuts[k], cuts[k + 1]]);
    }
  }
  return found;
}
