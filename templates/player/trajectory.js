/* A trajectory of Hamilton's equations by DOP853, and its difference from states of hamsym.solve. */

const MOST_STEPS = 20_000;
const TOLERANCE = 1e-11; // of a step, relative

/** A trajectory by DOP853, with the continuous extension of order 7 of its steps. */
class Trajectory {
  constructor(field, z0, [start, end], method, tolerance) {
    const dim = z0.length;
    Object.assign(this, { field, dim, method, tolerance, end, t: start, start, taken: 0, reason: "" });
    this.steps = []; // { t, h, z, terms }
    this.z = Float64Array.from(z0);
    this.rates = Array.from({ length: 16 }, () => new Float64Array(dim)); // of the stages
    this.trial = new Float64Array(dim);
    field(this.z, start, this.rates[0]);
    // Below a hundredth of the largest component of q or p a component counts as small.
    this.sizes = [0, 1].map((half) => {
      const of = (array) => Math.max(...array.subarray((half * dim) / 2, ((half + 1) * dim) / 2).map(Math.abs));
      return of(this.z) || (of(this.rates[0]) * Math.abs(end - start)) / 100 || 1;
    });
    const speed = Math.max(...this.rates[0].map((rate, i) => Math.abs(rate) / this.size(i)));
    this.h = Math.sign(end - start) * Math.min(0.01 / speed, Math.abs(end - start) / 10);
  }

  size(i) {
    return this.sizes[i < this.dim / 2 ? 0 : 1];
  }

  get done() {
    return this.t === this.end || this.reason !== "";
  }

  /** Take at most so many steps. */
  advance(count) {
    for (; count > 0 && !this.done; count--) {
      if (this.taken >= MOST_STEPS) this.reason = "it takes too many steps";
      else this.step();
    }
    return this;
  }

  step() {
    const { rates, trial, method, dim } = this;
    for (let attempt = 0, rejected = false; ; attempt++) {
      const rest = this.end - this.t;
      const last = Math.abs(this.h) >= Math.abs(rest);
      const h = last ? rest : this.h;
      if (!(Math.abs(h) > 4e-16 * Math.abs(this.t)) || attempt > 60) {
        this.reason = "it collides or escapes";
        return;
      }
      for (let s = 1; s < 12; s++) {
        this.combine(method.a[s], h);
        this.field(trial, this.t + method.c[s] * h, rates[s]);
      }
      this.combine(method.b, h);
      this.field(trial, this.t + h, rates[12]);
      const error = this.error(h);
      const factor = error === 0 ? 10 : 0.9 * error ** (-1 / 8);
      if (error < 1) {
        const z = trial.slice();
        this.steps.push({ t: this.t, h, z: this.z, terms: this.terms(h, z) });
        this.t = last ? this.end : this.t + h;
        this.z = z;
        rates[0].set(rates[12]);
        for (let i = 0; i < dim; i++) {
          const half = i < dim / 2 ? 0 : 1;
          this.sizes[half] = Math.max(this.sizes[half], Math.abs(z[i]));
        }
        this.h = h * Math.min(rejected ? 1 : 10, factor);
        this.taken++;
        return;
      }
      this.h = h * (factor > 0.2 ? factor : 0.2); // 0.2 too if the error is no number
      rejected = true;
    }
  }

  /** z + h times a sum of rates, into `trial`. */
  combine(weights, h) {
    const { trial, z, dim } = this;
    this.sum(weights, trial);
    for (let i = 0; i < dim; i++) trial[i] = z[i] + h * trial[i];
  }

  /** A sum of rates with weights. */
  sum(weights, out) {
    out.fill(0);
    for (let j = 0; j < weights.length; j++) {
      const weight = weights[j], rate = this.rates[j];
      if (weight) for (let i = 0; i < out.length; i++) out[i] += weight * rate[i];
    }
  }

  /** The estimated error of a step, as a part of what is allowed. */
  error(h) {
    const { rates, trial, z, dim, method } = this;
    let fifth = 0, third = 0;
    for (let i = 0; i < dim; i++) {
      const largest = Math.max(Math.abs(z[i]), Math.abs(trial[i]), 0.01 * this.size(i));
      let five = 0, three = 0;
      for (let j = 0; j < 13; j++) {
        five += method.e5[j] * rates[j][i];
        three += method.e3[j] * rates[j][i];
      }
      fifth += (five / (this.tolerance * largest)) ** 2;
      third += (three / (this.tolerance * largest)) ** 2;
    }
    if (fifth === 0) return 0;
    return (Math.abs(h) * fifth) / Math.sqrt((fifth + 0.01 * third) * dim);
  }

  /** Coefficients of the continuous extension. */
  terms(h, next) {
    const { rates, trial, method, z, dim } = this;
    for (let s = 13; s < 16; s++) {
      this.combine(method.a_extra[s - 13], h);
      this.field(trial, this.t + method.c_extra[s - 13] * h, rates[s]);
    }
    const terms = new Float64Array(7 * dim);
    for (let i = 0; i < dim; i++) {
      const change = next[i] - z[i];
      terms[i] = change;
      terms[dim + i] = h * rates[0][i] - change;
      terms[2 * dim + i] = 2 * change - h * (rates[12][i] + rates[0][i]);
    }
    for (let k = 3; k < 7; k++) {
      const term = terms.subarray(k * dim, (k + 1) * dim);
      this.sum(method.d[k - 3], term);
      for (let i = 0; i < dim; i++) term[i] *= h;
    }
    return terms;
  }

  /** The state within a step, at a share from 0 to 1 of it. */
  within(step, share, out) {
    const { dim } = this;
    for (let i = 0; i < dim; i++) {
      let value = 0;
      for (let k = 6; k >= 0; k--) {
        value += step.terms[k * dim + i];
        value *= k % 2 ? 1 - share : share;
      }
      out[i] = step.z[i] + value;
    }
    return out;
  }

  /** The state at a time, at the nearest one that is reached. */
  state(t, out) {
    const { steps } = this, sign = Math.sign(this.end - this.start);
    if (!steps.length) {
      out.set(this.z);
      return out;
    }
    let low = 0, high = steps.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (sign * steps[middle].t <= sign * t) low = middle;
      else high = middle - 1;
    }
    const share = (t - steps[low].t) / steps[low].h;
    return this.within(steps[low], Math.min(Math.max(share, 0), 1), out);
  }

  /** Times and states for curves, denser where the motion is fast. */
  samples() {
    const { steps, dim } = this;
    const count = steps.length ? Math.min(Math.max(6 * steps.length, 400), 1_600) : 0;
    const t = new Float64Array(count + 1), z = new Float64Array((count + 1) * dim);
    for (let k = 0; k <= count; k++) {
      const place = (k / (count || 1)) * steps.length;
      const step = steps[Math.min(Math.floor(place), steps.length - 1)];
      if (!step) {
        t[k] = this.start;
        z.set(this.z);
        break;
      }
      const share = k === count ? 1 : place - Math.floor(place);
      t[k] = step.t + share * step.h;
      this.within(step, share, z.subarray(k * dim, (k + 1) * dim));
    }
    return { t, z, count: count + 1, dim };
  }
}

/** Differences from the states of hamsym.solve, as parts of the size of each component. */
function largestDifference(trajectory, reference) {
  const bytes = Uint8Array.from(atob(reference.states), (letter) => letter.charCodeAt(0));
  const view = new DataView(bytes.buffer), dim = trajectory.dim, found = new Float64Array(dim);
  const count = bytes.length / 8 / dim;
  let largest = trajectory.t === trajectory.end ? 0 : Infinity;
  for (let k = 0; k < count; k++) {
    const t = trajectory.start + ((trajectory.end - trajectory.start) * k) / (count - 1);
    trajectory.state(t, found);
    for (let i = 0; i < dim; i++) {
      const difference = Math.abs(found[i] - view.getFloat64(8 * (k * dim + i), true)) / reference.sizes[i];
      if (!(difference <= largest)) largest = difference;
    }
  }
  return largest;
}
