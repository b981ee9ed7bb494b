#include "march.h"
#include "functions.h"

/* Distance of places from the ends of their window: units in the last place of the time at least, and
   at most where that is a small share of the window. */
#define LEAST_INSIDE 1.0
#define INSIDE 4.0
#define SMALL_INSIDE 1e-6
#define NOISE 8.0           /* times the typical change of the rates for one unit in the last place */
#define SLOW 20             /* iterations, after which the next window is shorter */
/* Slow windows after which longer ones are solved by Newton's method; the ratio of the lengths from
   which that pays, which is larger in large systems. */
#define PATIENCE 4
#define PAYS 3.0
#define ROUND_OFF_TESTS 3   /* estimates of the round-off of the rates in one window */
#define SHRINK 0.6
#define GROW 2.5
/* Of the allowed residual: what the next window aims at, and from where it need not be shorter. */
#define AIM 0.1
#define GOOD 0.3
#define ENOUGH 0.01         /* of the tolerance, to which the equation of a window is solved */
#define FIRST 0.7           /* length of the first window, in units of the shortest time of change */
#define NEAR 1e-6           /* of a short time, over which the change of the rates is measured */
#define SLIVER 1e-6         /* share of a window by which it is lengthened to reach a stop */
#define ITERATIONS 60
#define FROM_REST 8         /* iterations in which components may outgrow their first guess */
/* Unknowns above which shorter windows are tried, and how often; those above which the equations of
   Newton's method take most of its time. */
#define SMALL 600
#define RETRIES 3
/* Of a length at which the iteration failed: the longest of the next windows, and the growth of it with each. */
#define RETRIED 0.9
#define LATER 1.1
#define SMALL_MATRIX 100.0

/* -- memory ------------------------------------------------------------------------------------ */

void take_machine(arena *arena, machine *m, const program *p, long stride) {
  double *memory = take(arena, machine_size(p, stride));
  if (memory) make_machine(m, p, memory, stride);
}

void lay_out_march(marching *m, arena *arena, const equations *H, const tables *t) {
  long dim = H->dim, nodes = t->nodes, between = t->between;
  m->stride = nodes > between ? nodes : between;
  take_machine(arena, &m->velocity, H->velocity, m->stride);
  take_machine(arena, &m->force, H->force, m->stride);
  m->changes = (vw *)take(arena, LANES * dim);
  m->times = take(arena, nodes);
  m->basis = take(arena, t->terms * nodes);
  m->base = take(arena, dim * nodes);
  m->drifted = take(arena, dim / 2 * nodes);
  m->nearby = take(arena, dim * nodes);
  m->readout = take(arena, dim * t->columns);
  m->late = take(arena, m->stride);
  m->middle = take(arena, dim * between);
  m->flow = take(arena, dim * between);
  m->residual = take(arena, dim * between);
  m->disturbed = take(arena, (2 * dim + 1) * m->stride);
  double **small[] = {&m->scale, &m->weight, &m->sizes, &m->defects, &m->speeds, &m->noise};
  for (int k = 0; k < 6; k++) *small[k] = take(arena, dim);
}

/* x to the power y, of the same bits everywhere. */
static double power(double x, double y) {
  double row[8];
  fill(row, x, 8);
  hamsym_log(row, row, 8);
  for (int c = 0; c < 8; c++) row[c] *= y;
  hamsym_exp(row, row, 8);
  return row[0];
}

/* -- one window -------------------------------------------------------------------------------- */

void evaluate(machine *velocity, machine *force, const double *states, const double *times, long n, double *out) {
  run(velocity, states, times, n, out);
  run(force, states, times, n, out + velocity->program->results * n);
}

/* Times at places of a window, inside it by some units in the last place: at its ends, to which float64
   rounds places of short windows, a switch has neither of its values. */
void stretch(const double *places, double h, double start, long n, double *out) {
  double end = start + h, unit = EPS * greater(fabs(start), fabs(end));
  double margin = greater(LEAST_INSIDE * unit, lesser(INSIDE * unit, SMALL_INSIDE * fabs(end - start)));
  double low = lesser(start, end) + margin, high = greater(start, end) - margin;
  for (long c = 0; c < n; c++) out[c] = lesser(greater(h * places[c] + start, low), high);
}

/* Typical change of the rates for one unit in the last place, times a factor: the mean in each row
   without its largest, which may lie at a jump. */
static void round_off(marching *m, const settings *s, long dim, long n, const double *states, const double *times,
                      const double *rates, double factor) {
  double *nearby = m->disturbed, *changed = nearby + dim * n, *late = changed + dim * n;
  disturb(states, s->sign, s->width, EPS, dim, n, nearby);
  disturb(times, s->sign, s->width, EPS, 1, n, late);
  evaluate(&m->velocity, &m->force, nearby, late, n, changed);
  for (long i = 0; i < dim; i++) {
    double total = 0.0, largest = 0.0;
    for (long c = 0; c < n; c++) {
      double change = fabs(changed[i * n + c] - rates[i * n + c]);
      total += change;
      largest = greater(largest, change);
    }
    m->noise[i] = factor * (total - largest) / (n - 1);
  }
}

/* One iteration: the momenta with the force at the last coordinates, then the coordinates with the velocity at
   the new momenta, which needs half as many iterations as both at once. Where the velocity is linear, the
   coordinates follow from the force directly, by one product instead of two. */
static void approach(marching *m, const equations *H, const tables *t, progress *p, double h) {
  long half = H->dim / 2, n = t->nodes;
  double *slopes = p->found + half * n;
  run(&m->force, m->nearby, m->times, n, slopes);
  if (H->linear) {
    run(&m->velocity, p->found, m->times, n, m->disturbed);
    advance(t->twice, n, m->disturbed, half, m->drifted, h * h, m->nearby, m->changes);
    return;
  }
  advance(t->integration, n, slopes, half, m->base + half * n, h, m->nearby + half * n, m->changes + half);
  run(&m->velocity, m->nearby, m->times, n, p->found);
  advance(t->integration, n, p->found, half, m->base, h, m->nearby, m->changes);
}

/* The rates at the coordinates that the iteration has found, where it left out the momenta. */
static void complete(marching *m, const equations *H, const tables *t, progress *p, double h) {
  long half = H->dim / 2, n = t->nodes;
  if (!H->linear) return;
  double *slopes = p->found + half * n;
  run(&m->force, m->nearby, m->times, n, slopes);
  advance(t->integration, n, slopes, half, m->base + half * n, h, m->nearby + half * n, m->changes + half);
  run(&m->velocity, m->nearby, m->times, n, p->found);
}

/* Set the scales of the components: the largest magnitudes so far, those in this window included. */
static void measure(marching *m, const settings *s, const progress *p, const double *z, long dim, long n) {
  for (long i = 0; i < dim; i++) {
    double size = larger(greater(greater(p->size[i], s->floor[i]), TINY), fabs(z[i]));
    m->scale[i] = larger(row_size(m->nearby + i * n, n), size);
    m->weight[i] = 1.0 / m->scale[i];
  }
}

/* Solve the collocation equation of a window of length h from the state z by fixed-point iteration. `longer` is
   the length relative to the last window, 0 for the first. Returns the iterations, 0 without convergence;
   p->found has the rates. */
static int iterate(marching *m, const equations *H, const tables *t, const settings *s, progress *p,
                   const double *z, double h, double longer) {
  long dim = H->dim, half = dim / 2, n = t->nodes;
  double enough = greater(ENOUGH * s->tolerance, 4e-16);
  stretch(t->node, h, p->clock[0], n, m->times);
  for (long i = 0; i < dim; i++) fill(m->base + i * n, z[i], n);
  memcpy(m->nearby, m->base, dim * n * sizeof(double));
  /* The series of the last window is continued into this one. */
  for (long c = 0; c < n; c++) m->late[c] = 1.0 + 2.0 * longer * t->node[c];
  chebyshev_rows(m->late, t->terms, n, m->basis);
  long guessed = H->linear ? half : dim; /* coordinates alone, where momenta are left out */
  products(m->basis, t->terms, n, p->tail, guessed, p->found);
  advance(t->integration, n, p->found, guessed, m->base, h, m->nearby, m->changes);
  measure(m, s, p, z, dim, n);
  if (H->linear) {
    run(&m->velocity, m->base, m->times, n, m->disturbed);
    memcpy(m->drifted, m->base, half * n * sizeof(double));
    advance(t->integration, n, m->disturbed, half, m->base, h, m->drifted, m->changes);
  }
  double last = INFINITY;
  int tests = 0;
  for (int iteration = 1; iteration <= ITERATIONS; iteration++) {
    p->counts[1]++;
    approach(m, H, t, p, h);
    double change, kick;
    for (int again = 0;; again++) {
      change = weighted_change(m->changes, m->weight, half);
      kick = H->linear ? 0.0 : weighted_change(m->changes + half, m->weight + half, half);
      if (again || iteration > FROM_REST || !(larger(change, kick) > 1.0)) break;
      measure(m, s, p, z, dim, n);
    }
    /* The momenta of a separable H follow the coordinates of the last iteration: their next change is
       smaller by as much as that of the coordinates is. */
    if (!(H->separable && change <= last)) change = larger(kick, change);
    else if (iteration > 1) change = larger(kick * (change / last), change);
    if (change <= enough || (change < 1e-12 && change >= last)) {
      complete(m, H, t, p, h);
      return iteration;
    }
    if (change >= last && tests < ROUND_OFF_TESTS) {
      /* A component may stay away from its limit by the round-off of its rate, which is that at the same
         states: where the iteration diverges, those of the last one are far away. */
      tests++;
      p->counts[1] += 2;
      complete(m, H, t, p, h);
      evaluate(&m->velocity, &m->force, m->nearby, m->times, n, p->found);
      round_off(m, s, dim, n, m->nearby, m->times, p->found, NOISE * fabs(h));
      int settled = 1;
      for (long i = 0; i < (H->linear ? half : dim); i++) {
        double allowed = m->noise[i] + enough * m->scale[i];
        settled = settled && largest_lane(m->changes[i]) <= allowed;
      }
      if (settled) return iteration;
    }
    if (!(change < 1e9) || (iteration > 31 && change > 0.9 * last)) return 0;
    last = change;
  }
  return 0;
}

/* Largest defect, without a share of its round-off, in units of the allowed one; NaN if there is one. No window is
   short enough to bring the residual below the round-off of the rates. */
static double worst(const marching *m, const settings *s, long dim, double length, double share) {
  double found = 0.0;
  for (long i = 0; i < dim; i++) {
    double allowed = s->tolerance * greater(m->sizes[i], s->floor[i]) + ROUND_OFF * length * m->speeds[i];
    double defect = larger(m->defects[i] - share * m->noise[i], 0.0);
    found = larger(defect / (greater(allowed, TINY) + m->noise[i]), found);
  }
  return found;
}

/* Compare the residual between the nodes of a window with the tolerance: the largest ratio to the allowed
   one, and in m->beyond that without round-off. m->sizes has the largest magnitudes of the components so far, this
   window included. */
static double judge(marching *m, const equations *H, const tables *t, const settings *s, progress *p,
                    const double *z, double h) {
  long dim = H->dim, n = t->between;
  double length = fabs(h);
  stretch(t->place, h, p->clock[0], n, m->late);
  products(t->to_between, t->columns, n, m->readout, dim, m->middle);
  shift(m->middle, z, dim, n);
  evaluate(&m->velocity, &m->force, m->middle, m->late, n, m->flow);
  products(t->rates_between, t->columns, n, m->readout, dim, m->residual);
  for (long c = 0; c < dim * n; c++) m->residual[c] = m->residual[c] / h - m->flow[c];
  for (long i = 0; i < dim; i++) {
    m->sizes[i] = larger(row_size(m->middle + i * n, n), p->size[i]);
    m->defects[i] = length * row_size(m->residual + i * n, n);
    m->speeds[i] = row_size(p->found + i * t->nodes, t->nodes);
    m->noise[i] = 0.0;
  }
  p->counts[1]++;
  m->beyond = worst(m, s, dim, length, 0.0);
  if (m->beyond <= GOOD) return m->beyond;
  /* Where large terms cancel, the round-off is many units of the rates. */
  p->counts[1]++;
  round_off(m, s, dim, n, m->middle, m->late, m->flow, NOISE * length);
  m->beyond = worst(m, s, dim, length, 1.0);
  return worst(m, s, dim, length, 0.0);
}

/* -- the march --------------------------------------------------------------------------------- */

/* A length for the first window, from the times in which the components change: with the slopes a of the
   rates f along the motion, component z changes in the longer of the times sqrt(z/a) and f/a. */
double first_length(marching *m, const equations *H, const double *z, const double *rates, double start, double end) {
  long dim = H->dim, n = 8;
  double whole = fabs(end - start), time = whole;
  for (long i = 0; i < dim; i++)
    if (rates[i] != 0.0 && z[i] != 0.0) time = lesser(time, fabs(z[i] / rates[i]));
  double step = copysign(NEAR * time, end - start);
  double *near = m->disturbed, *later = m->disturbed + dim * n;
  for (long i = 0; i < dim; i++) fill(near + i * n, z[i] + step * rates[i], n);
  fill(m->late, start + step, n);
  evaluate(&m->velocity, &m->force, near, m->late, n, later);
  time = whole;
  for (long i = 0; i < dim; i++) {
    double slope = fabs((later[i * n] - rates[i]) / step);
    if (!(slope > 0.0 && slope < INFINITY)) continue;
    /* A rate that grows beyond itself within the step is that of a component at rest: it tells no time. */
    double turn = fabs(rates[i]) / slope, own = greater(sqrt(fabs(z[i]) / slope), turn > fabs(step) ? turn : 0.0);
    if (own > 0.0) time = lesser(time, own);
  }
  return FIRST * time;
}

/* Fill windows from p->counts[0] on. `given`: the rates of the first one are in p->found already. */
int march(marching *m, const equations *H, const tables *t, const settings *s, progress *p, windows *w, int given) {
  long dim = H->dim, unknowns = dim * t->nodes;
  double *clock = p->clock;
  int64_t *counts = p->counts;
  double direction = s->stop[s->stops - 1] > clock[0] ? 1.0 : -1.0;
  double last_length = counts[0] ? fabs(clock[0] - w->edge[counts[0] - 1]) : 0.0;
  double pays = PAYS * (1.0 + (unknowns / SMALL_MATRIX) * (unknowns / SMALL_MATRIX));
  /* Where the iteration fails, Newton's method follows; in large systems only after shorter windows failed
     too, or right after a window that needed it. */
  double failed = INFINITY; /* length at which the iteration failed last, and more after each window since then */
  int stiff = given, failures = 0, retries = unknowns <= SMALL && !s->patient ? 0 : RETRIES;
  set_parameters(&m->velocity, s->parameters, m->stride);
  set_parameters(&m->force, s->parameters, m->stride);
  while (counts[2] < s->stops) {
    double stop = s->stop[counts[2]], left = fabs(stop - clock[0]);
    double length = lesser(lesser(clock[1], s->longest), left);
    long count = counts[0];
    /* Equal windows may miss the stop by round-off: no sliver is left before it. */
    if (left - length < SLIVER * length) length = left;
    /* The difference of two times that float64 has: others round each window's length. */
    double end = length == left ? stop : clock[0] + direction * length;
    double h = end - clock[0];
    clock[1] = length = fabs(h);
    if (!(length >= s->shortest)) return TOO_SHORT;
    if (count == w->room) return FULL;
    const double *z = w->state + count * dim;
    double *next = w->state + (count + 1) * dim;
    int slow = 0;
    if (!given) {
      int iterations = iterate(m, H, t, s, p, z, h, count ? length / last_length : 0.0);
      slow = iterations > SLOW + 1;
      if (slow && counts[3] >= PATIENCE) return NEWTON;
      if (!iterations) {
        if (stiff || failures >= retries || counts[3] >= PATIENCE) return NEWTON;
        failures++;
        failed = length;
        clock[1] = length * SHRINK;
        continue;
      }
      stiff = 0;
    }
    int by_newton = given;
    given = 0;
    products(t->fit, t->nodes, t->columns, p->found, dim, m->readout);
    for (long k = 0; k < dim * t->columns; k++) m->readout[k] *= h;
    double error = judge(m, H, t, s, p, z, h);
    if (!(error <= 1.0)) { /* also where it is NaN */
      double factor = isfinite(error) ? power(GOOD / error, 1.0 / t->order) : 0.3;
      clock[1] = length * lesser(greater(factor, 0.3), 0.9);
      continue;
    }
    for (long i = 0; i < dim; i++) {
      const double *row = m->readout + i * t->columns;
      /* Rounding the weights would push every window the same way, and energies would drift. */
      next[i] = weighted_sum(row, t->end, t->end_low, t->columns) + z[i];
      for (long k = 0; k < w->readout; k++) w->coefficient[(count * w->readout + k) * dim + i] = row[k];
      p->size[i] = m->sizes[i];
    }
    clock[0] = end;
    if (end == stop) counts[2]++;
    w->edge[count + 1] = end;
    counts[0]++;
    failures = 0;
    products(t->extrapolation, t->nodes, t->terms, p->found, dim, p->tail);
    /* Shorter windows have no less round-off. */
    double growth = lesser(m->beyond < error ? LATER : GROW, power(AIM / greater(m->beyond, 1e-30), 1.0 / t->order));
    if (m->beyond <= GOOD) growth = greater(growth, 1.0);
    last_length = length;
    clock[1] = lesser(length * (slow ? SHRINK : growth), s->patient ? RETRIED * failed : INFINITY);
    failed *= LATER;
    if (slow) {
      counts[3]++;
      clock[2] = length;
    } else if (growth <= 1.0 && counts[3] >= PATIENCE) {
      /* The residual limits the windows: they are worth Newton's method, or are not. */
      if (!by_newton) counts[3] = 0;
      else if (length < pays * clock[2]) counts[3] = -PAUSE;
      else clock[2] = 0.0;
    }
  }
  return FINISHED;
}
