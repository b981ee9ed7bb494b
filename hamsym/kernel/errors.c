#include "errors.h"
#include <stdlib.h>

#define COHERENT 2.0    /* times the round-off of independent places */
#define RESOLVED 1e-3   /* residual, relative to the rates, that a smooth force leaves at most */
#define LARGEST 1.0     /* error, in units of the motion, beyond which there is no estimate */
#define CURVED 1e-3     /* of the error in a window: round-off of the terms beyond the linear one, at most */
#define PASSING 10.0    /* typical errors: larger ones may pass, so their vectors are solved more accurately */
/* Times a peak between two of the values that show it; and of the integral of the residual, which oscillates as fast
   as these values show, a share more. */
#define MISSED 1.1
#define OSCILLATING 0.15
#define FEW 400         /* windows in which the rounding of a table, alike in all of them, is less than round-off */
#define ITERATIONS 60
#define LEAST_SIZE 1e-280 /* of vectors, whose reciprocal relative to an accuracy is finite */
#define KEPT 8          /* windows after one that coarse nodes do not resolve, in which they are not tried */

void lay_out_errors(carrying *m, arena *arena, const equations *H, const error_tables *t, const actions *a) {
  long dim = H->dim, places = t->places, nodes = t->fine->nodes, rows = dim * (t->perturbations + 2);
  m->each = t->perturbations + 2;
  m->stride = places > nodes ? places : nodes;
  take_machine(arena, &m->velocity, H->velocity, m->stride);
  take_machine(arena, &m->force, H->force, m->stride);
  take_machine(arena, &m->hessian, H->hessian, m->stride);
  m->shifted = arena->memory && (can_shift(&m->velocity) || can_shift(&m->force));
  m->terms = (term *)take(arena, 4 * a->terms + 1);
  m->changes = (vw *)take(arena, LANES * rows);
  m->second = take(arena, H->hessian->results * nodes + 1);
  m->readout = take(arena, dim * t->columns);
  m->curvature = take(arena, H->hessian->results * places + 1);
  double **of_places[] = {&m->z, &m->dz, &m->low, &m->rates, &m->disturbed, &m->pushed, &m->drift_inside, &m->found,
                          &m->coefficients, &m->shown, &m->bent, &m->steady, &m->steady_pushed};
  for (int k = 0; k < 13; k++) *of_places[k] = take(arena, dim * places);
  m->times = take(arena, places);
  m->late = take(arena, places);
  double **of_nodes[] = {&m->at_nodes, &m->drift, &m->smooth};
  for (int k = 0; k < 3; k++) *of_nodes[k] = take(arena, dim * nodes);
  m->node_times = take(arena, nodes);
  m->base = take(arena, rows * nodes);
  m->drifted = take(arena, rows / 2 * nodes);
  m->vectors = take(arena, rows * nodes);
  m->moved = take(arena, rows * nodes);
  m->last = take(arena, rows * 8);
  m->before = take(arena, rows);
  m->weight = take(arena, rows);
  m->speeds = take(arena, dim);
  m->tops = take(arena, dim);
}

/* -- the tangent equation ---------------------------------------------------------------------- */

/* Sums of terms of one row and source rows, for all vectors, of which there are `each`, a constant. */
INLINE void apply_terms(const term *first, const term *end, const double *second, const double *vectors, long n,
                        long each, double *out) {
  for (long c = 0; c < n; c += LANES) {
    vw sums[EACH_MOST];
    for (long k = 0; k < each; k++) sums[k] = (vw){0.0};
    for (const term *one = first; one < end; one++) {
      const double *source = vectors + one->source * each * n + c;
      vw weight = one->factor * load(second + one->entry * n + c);
      for (long k = 0; k < each; k++) sums[k] += weight * load(source + k * n);
    }
    for (long k = 0; k < each; k++) store(out + k * n + c, sums[k]);
  }
}

/* Write `count` components of A V from the component `row` on; V has a row for each component and vector. */
static void apply(const carrying *m, const term *first, const term *end, const double *vectors, long row, long count,
                  long n, double *out) {
  for (long i = row; i < row + count; i++, out += m->each * n) {
    const term *last = first;
    while (last < end && last->row == i) last++;
    if (m->each == EACH_MOST) apply_terms(first, last, m->second, vectors, n, EACH_MOST, out);
    else apply_terms(first, last, m->second, vectors, n, EACH_FEWER, out);
    first = last;
  }
}

/* Weights of the changes: the reciprocal of the size of each component over its vectors at three nodes,
   times a factor. */
static void weigh(carrying *m, long dim, long n, double factor) {
  for (long i = 0; i < dim; i++) {
    double size = LEAST_SIZE;
    for (long row = i * m->each; row < (i + 1) * m->each; row++) {
      const double *values = m->vectors + row * n;
      size = larger(larger(fabs(values[0]), larger(fabs(values[(n - 1) / 2]), fabs(values[n - 1]))), size);
    }
    double weight = 1.0 / (factor * size);
    for (long row = i * m->each; row < (i + 1) * m->each; row++) m->weight[row] = weight;
  }
}

/* Products A V of all components. */
static void apply_all(carrying *m, const actions *a, long dim, long n) {
  const term *middle = m->terms + a->velocities, *end = m->terms + a->terms;
  apply(m, middle, end, m->vectors, dim / 2, dim / 2, n, m->moved + dim / 2 * m->each * n);
  apply(m, m->terms, middle, m->vectors, 0, dim / 2, n, m->moved);
}

/* Largest last coefficients of vectors of so many components, relative to the weights. */
static double unresolved(carrying *m, const rule *rule, long dim) {
  products(rule->last, rule->nodes, 8, m->vectors, dim * m->each, m->last);
  double found = 0.0;
  for (long row = 0; row < dim * m->each; row++)
    found = larger(m->weight[row] * larger(fabs(m->last[8 * row]), fabs(m->last[8 * row + 1])), found);
  return found;
}

/* Whether an iteration with these changes, in units of the accuracy, is at its end: the next ones are smaller by
   as much as this one is. */
static int settled(double change, double last) { return change * (change < last ? change / last : 1.0) <= 1.0; }

/* The tangent equation where the coordinates' rates are linear in the momenta alone: the coordinates follow from
   the forces directly, by one product in each iteration instead of two. */
static int transport_linear(carrying *m, const rule *rule, const actions *a, long dim, double h, double accuracy) {
  long n = rule->nodes, half = dim / 2, rows = half * m->each;
  double *slopes = m->moved + rows * n, last = 0.0;
  const term *middle = m->terms + a->velocities, *end = m->terms + a->terms;
  apply(m, m->terms, middle, m->base, 0, half, n, m->moved);
  advance(rule->integration, n, m->moved, rows, m->base, h, m->drifted, m->changes);
  memcpy(m->vectors, m->drifted, rows * n * sizeof(double));
  for (int iteration = 1; iteration <= ITERATIONS; iteration++) {
    apply(m, middle, end, m->vectors, half, half, n, slopes);
    apply(m, m->terms, middle, m->moved, 0, half, n, m->moved);
    advance(rule->twice, n, m->moved, rows, m->drifted, h * h, m->vectors, m->changes);
    if (iteration < 2) continue;
    weigh(m, half, n, accuracy);
    double largest = weighted_change(m->changes, m->weight, rows);
    if (!(largest < 1e100)) return 0;
    if (iteration > 2 && settled(largest, last)) {
      apply(m, middle, end, m->vectors, half, half, n, slopes);
      advance(rule->integration, n, slopes, rows, m->base + rows * n, h, m->vectors + rows * n, m->changes);
      apply(m, m->terms, middle, m->vectors, 0, half, n, m->moved);
      return 1;
    }
    last = largest;
  }
  return 0;
}

/* Solve the tangent equation of a window for all vectors; m->moved has the products A V. */
static int transport(carrying *m, const rule *rule, const actions *a, long dim, double h, double accuracy) {
  long n = rule->nodes, half = dim / 2, rows = half * m->each;
  double *slopes = m->moved + rows * n, *kicked = m->vectors + rows * n, last = 0.0;
  const term *middle = m->terms + a->velocities, *end = m->terms + a->terms;
  memcpy(m->vectors, m->base, 2 * rows * n * sizeof(double));
  for (int iteration = 1; iteration <= ITERATIONS; iteration++) {
    apply(m, middle, end, m->vectors, half, half, n, slopes);
    advance(rule->integration, n, slopes, rows, m->base + rows * n, h, kicked, m->changes + rows);
    apply(m, m->terms, middle, m->vectors, 0, half, n, m->moved);
    advance(rule->integration, n, m->moved, rows, m->base, h, m->vectors, m->changes);
    if (iteration < 2) continue;
    weigh(m, dim, n, accuracy);
    double largest = weighted_change(m->changes, m->weight, 2 * rows);
    if (!(largest < 1e100)) return 0;
    if (iteration > 2 && settled(largest, last)) return 1;
    last = largest;
  }
  return 0;
}

/* Solve it by elimination with pivots; return whether there is a finite solution. */
static int eliminate(carrying *m, const rule *rule, const actions *a, long dim, double h) {
  long n = rule->nodes, size = dim * n, wide = size + m->each;
  double *matrix = calloc(size * wide, sizeof(double));
  if (!matrix) return 0;
  for (long row = 0; row < size; row++) {
    matrix[row * wide + row] = 1.0;
    for (long k = 0; k < m->each; k++)
      matrix[row * wide + size + k] = m->base[((row / n) * m->each + k) * n + row % n];
  }
  for (const term *one = m->terms; one < m->terms + a->terms; one++)
    for (long c = 0; c < n; c++)
      for (long d = 0; d < n; d++)
        matrix[(one->row * n + c) * wide + one->source * n + d] -=
            h * one->factor * rule->integration[d * n + c] * m->second[one->entry * n + d];
  int good = 1;
  for (long k = 0; k < size && good; k++) {
    long pivot = k;
    for (long row = k + 1; row < size; row++)
      if (fabs(matrix[row * wide + k]) > fabs(matrix[pivot * wide + k])) pivot = row;
    double *first = matrix + k * wide, *other = matrix + pivot * wide;
    good = fabs(other[k]) > 0.0 && isfinite(other[k]);
    if (!good) break;
    for (long c = k; c < wide && pivot != k; c++) {
      double value = first[c];
      first[c] = other[c];
      other[c] = value;
    }
    for (long row = k + 1; row < size; row++) {
      double *line = matrix + row * wide, factor = line[k] / first[k];
      if (factor == 0.0) continue;
      for (long c = k + 1; c < wide; c++) line[c] -= factor * first[c];
    }
  }
  for (long row = size - 1; row >= 0 && good; row--)
    for (long k = 0; k < m->each; k++) {
      double *line = matrix + row * wide, total = line[size + k];
      for (long c = row + 1; c < size; c++) total -= line[c] * matrix[c * wide + size + k];
      line[size + k] = total / line[row];
      m->vectors[((row / n) * m->each + k) * n + row % n] = line[size + k];
      good = good && isfinite(line[size + k]);
    }
  free(matrix);
  apply_all(m, a, dim, n);
  return good;
}

/* Subtract from one of the vectors of each component at their start what A times the integral of its residual drives. */
static void drive(carrying *m, const rule *rule, const error_tables *t, const error_settings *s, const double *pushed,
                  long vector, long dim, double h) {
  long n = rule->nodes;
  products(rule->drift, t->places, n, pushed, dim, m->drift);
  for (long i = 0; i < dim; i++)
    for (long c = 0; c < n; c++)
      m->base[(i * m->each + vector) * n + c] -= m->drift[i * n + c] * (h * h / s->scale[i]);
}

/* Integral over a window of a residual and what A times its own integral adds, of one component. */
static double through(const error_tables *t, const double *residual, const double *pushed, double h) {
  return dot(residual, t->drift_end, t->places) + h * dot(pushed, t->drift_end, t->places);
}

/* Solve it at the nodes of a rule from the vectors at the start of window k; `coarse`: only if they resolve it. */
static int solve_at(carrying *m, const equations *H, const rule *rule, const error_tables *t, const actions *a,
                    const error_settings *s, const windows *w, const double *joint, long k, double accuracy,
                    int coarse) {
  long dim = H->dim, n = rule->nodes;
  double h = w->edge[k + 1] - w->edge[k];
  products(rule->at_nodes, t->columns, n, m->readout, dim, m->at_nodes);
  shift(m->at_nodes, w->state + k * dim, dim, n);
  stretch(rule->node, h, w->edge[k], n, m->node_times);
  run(&m->hessian, m->at_nodes, m->node_times, n, m->second);
  for (long row = 0; row < dim * m->each; row++) fill(m->base + row * n, joint[row], n);
  drive(m, rule, t, s, m->pushed, 0, dim, h);
  if (m->shifted) drive(m, rule, t, s, m->steady_pushed, m->each - 1, dim, h);
  int solved = a->linear ? transport_linear(m, rule, a, dim, h, accuracy) : transport(m, rule, a, dim, h, accuracy);
  if (coarse) return solved && unresolved(m, rule, a->linear ? dim / 2 : dim) <= t->resolved;
  return solved || eliminate(m, rule, a, dim, h);
}

/* -- one window -------------------------------------------------------------------------------- */

/* Write the residual of window k to m->dz, with the rates, the states and the times; return marks. */
static int residual(carrying *m, const equations *H, const error_tables *t, const error_settings *s,
                    const windows *w, long k, double h, int exact) {
  long dim = H->dim, places = t->places;
  for (long c = 0; c < w->readout; c++)
    for (long i = 0; i < dim; i++) m->readout[i * t->columns + c] = w->coefficient[(k * w->readout + c) * dim + i];
  products(t->value, t->columns, places, m->readout, dim, m->z);
  products(t->rate, t->columns, places, m->readout, dim, m->dz);
  /* A rounded table pushes every window the same way. */
  if (exact) {
    products(t->value_low, t->columns, places, m->readout, dim, m->low);
    for (long c = 0; c < dim * places; c++) m->z[c] += m->low[c];
    products(t->rate_low, t->columns, places, m->readout, dim, m->low);
    for (long c = 0; c < dim * places; c++) m->dz[c] += m->low[c];
  }
  shift(m->z, w->state + k * dim, dim, places);
  stretch(t->place, h, w->edge[k], places, m->times);
  evaluate(&m->velocity, &m->force, m->z, m->times, places, m->rates);
  for (long c = 0; c < dim * places; c++) m->dz[c] = m->dz[c] / h - m->rates[c];
  if (s->residual) memcpy(m->dz, s->residual + k * dim * places, dim * places * sizeof(double));
  int mark = 0;
  double length = fabs(h);
  for (long i = 0; i < dim; i++) {
    double left = row_size(m->dz + i * places, places);
    m->speeds[i] = row_size(m->rates + i * places, places);
    m->tops[i] = row_size(m->z + i * places, places);
    /* The rates of components that are nothing but round-off are noise. */
    if (!(left <= RESOLVED * m->speeds[i] || s->usual_length * left <= RESOLVED * s->scale[i])) mark |= UNRESOLVED;
    double allowed = s->tolerance * s->size[i] + ROUND_OFF * length * m->speeds[i];
    if (!(length * left <= SLACK * allowed)) mark |= EXCESSIVE;
  }
  return mark;
}

/* Write the change of the rates where states, times and the results of all operations are rounded otherwise, `factor`
   times, to m->disturbed. Roundings of numbers, and of what depends on parameters alone, push every window the same way:
   they are a residual of the last vector, m->steady. Returns whether both are finite. */
static int change_rates(carrying *m, const equations *H, const error_tables *t, const error_settings *s, double factor) {
  long dim = H->dim, places = t->places, half = H->velocity->results;
  const double *signs = s->sign, *of_steps = signs + dim * places;
  if (m->shifted) {
    run_shifted(&m->velocity, m->z, m->times, places, of_steps, factor, m->steady);
    run_shifted(&m->force, m->z, m->times, places, of_steps, factor, m->steady + half * places);
    for (long c = 0; c < dim * places; c++) m->steady[c] = (m->rates[c] - m->steady[c]) / factor;
  }
  disturb(m->z, signs, places, factor * (EPS / 2), dim, places, m->low);
  /* Residuals that are given belong to the times as rounded. */
  disturb(m->times, signs, places, s->residual ? 0.0 : factor * (EPS / 2), 1, places, m->late);
  run_disturbed(&m->velocity, m->low, m->late, places, of_steps, factor * SPREAD, m->disturbed);
  run_disturbed(&m->force, m->low, m->late, places, of_steps, factor * SPREAD, m->disturbed + half * places);
  for (long c = 0; c < dim * places; c++) m->disturbed[c] = (m->disturbed[c] - m->rates[c]) / factor;
  return larger(row_size(m->steady, dim * places), row_size(m->disturbed, dim * places)) < INFINITY;
}

/* Round-off of window k is added to the vectors at its start. */
static void disturb_vectors(carrying *m, const equations *H, const error_tables *t, const error_settings *s,
                            double *joint, long k, double length) {
  long dim = H->dim, places = t->places, count = t->perturbations;
  const double *kicks = s->kick + (k % s->period) * dim * count;
  /* Beside the edge of a domain, as of a root, magnified roundings may leave it. */
  if (!change_rates(m, H, t, s, MAGNIFIED)) change_rates(m, H, t, s, 1.0);
  for (long i = 0; i < dim; i++) {
    const double *change = m->disturbed + i * places;
    double noise = __builtin_sqrt(dot(change, change, places) / places);
    /* The places average the round-off, but not independently. */
    double kick = COHERENT * length * (noise + EPS * m->speeds[i]) / __builtin_sqrt(places) / s->scale[i];
    /* Times at which H switches are few: their random signs may cancel, those of the last vector do not. */
    double late = s->late ? s->late[k * dim + i] / s->scale[i] : 0.0;
    kick += late;
    for (long j = 0; j < count; j++) joint[i * m->each + 1 + j] += kick * kicks[i * count + j];
    joint[(i + 1) * m->each - 1] += late;
  }
}

/* Products of A and one row for each component at the places. */
static void apply_at_places(carrying *m, const error_tables *t, const actions *a, long dim, const double *rows, double *out) {
  const term *first = a->term, *end = a->term + a->terms;
  for (long i = 0; i < dim; i++, out += t->places) {
    const term *last = first;
    while (last < end && last->row == i) last++;
    apply_terms(first, last, m->curvature, rows, t->places, 1, out);
    first = last;
  }
}

/* Integrals D of the residual, and of that of the last vector, from the start of a window to the places, and A D. */
static void push(carrying *m, const equations *H, const error_tables *t, const actions *a) {
  products(t->drift, t->places, t->places, m->dz, H->dim, m->drift_inside);
  apply_at_places(m, t, a, H->dim, m->drift_inside, m->pushed);
  if (!m->shifted) return;
  products(t->drift, t->places, t->places, m->steady, H->dim, m->low);
  apply_at_places(m, t, a, H->dim, m->low, m->steady_pushed);
}

/* Write by how much the terms of the equation of the error beyond the linear one, at the error found last, differ from
   those that are in the residual, to m->disturbed. Returns by how much that changes the error, in units of the scale. */
static double beyond(carrying *m, const equations *H, const error_tables *t, const actions *a, const error_settings *s,
                     double length) {
  long dim = H->dim, places = t->places;
  for (long c = 0; c < dim * places; c++) m->low[c] = m->z[c] + m->found[c];
  evaluate(&m->velocity, &m->force, m->low, m->times, places, m->disturbed);
  apply_at_places(m, t, a, dim, m->found, m->low);
  for (long c = 0; c < dim * places; c++) m->disturbed[c] -= m->rates[c] + m->low[c] + m->bent[c];
  products(t->drift, places, places, m->disturbed, dim, m->shown);
  double change = 0.0;
  for (long i = 0; i < dim; i++)
    change = larger(length * row_size(m->shown + i * places, places) / s->scale[i], change);
  return change;
}

/* Write the error inside a window to m->found; return its size in units of the scale. */
static double find_error(carrying *m, const equations *H, const error_tables *t, const rule *rule,
                         const error_settings *s, double h) {
  long dim = H->dim, n = rule->nodes, count = t->places;
  for (long i = 0; i < dim; i++)
    for (long c = 0; c < n; c++) m->smooth[i * n + c] = m->vectors[i * m->each * n + c] * s->scale[i];
  products(rule->lift, n, count, m->smooth, dim, m->found);
  /* The vectors lack what oscillates faster than their nodes show. */
  products(rule->beyond, count, count, m->pushed, dim, m->shown);
  for (long c = 0; c < dim * count; c++) m->found[c] -= h * (m->drift_inside[c] + h * m->shown[c]);
  double size = 0.0;
  for (long i = 0; i < dim; i++) size = larger(row_size(m->found + i * count, count) / s->scale[i], size);
  return size;
}

/* Solve the equation of the error in window k by the coarse nodes, where these resolve it, or else by the fine ones.
   Returns the rule whose nodes have the vectors, null if there is no solution. */
static const rule *solve_window(carrying *m, const equations *H, const error_tables *t, const actions *a,
                                const error_settings *s, const windows *w, const double *joint, long k,
                                double accuracy, long *coarse_from) {
  push(m, H, t, a);
  if (k >= *coarse_from) {
    if (solve_at(m, H, t->coarse, t, a, s, w, joint, k, accuracy, 1)) return t->coarse;
    *coarse_from = k + 1 + KEPT;
  }
  return solve_at(m, H, t->fine, t, a, s, w, joint, k, accuracy, 0) ? t->fine : 0;
}

/* Add the error inside window k and the round-off to the results. Returns whether it is finite. */
static int inside(carrying *m, const equations *H, const error_tables *t, const rule *rule, const error_settings *s,
                  error_results *r, long k, double length) {
  long dim = H->dim, n = rule->nodes, count = t->places;
  products(t->dense, count, count, m->found, dim, m->shown);
  for (long i = 0; i < dim; i++) {
    const double *vectors = m->vectors + i * m->each * n;
    vw most = {0.0};
    for (long c = 0; c < n; c += LANES) {
      vw total = {0.0};
      for (long j = 1; j <= t->perturbations; j++) total += load(vectors + j * n + c) * load(vectors + j * n + c);
      most = larger_lanes(total, most);
    }
    double largest = largest_lane(most), last = row_size(vectors + (m->each - 1) * n, n);
    /* Some standard deviations, at worst in the window, and the rounding of z^ itself. */
    double floor = t->deviations * __builtin_sqrt(largest / t->perturbations) + MISSED * last;
    floor = s->scale[i] * floor + EPS / 2 * m->tops[i];
    double top = larger(row_size(m->shown + i * count, count), row_size(m->found + i * count, count));
    double peak = MISSED * top + OSCILLATING * length * row_size(m->drift_inside + i * count, count) + floor;
    if (!(peak < INFINITY)) return 0;
    r->largest[i] = larger(peak, r->largest[i]);
    if (r->floor) r->floor[k * dim + i] = floor;
  }
  if (!r->series) return 1;
  products(t->to_series, count, count, m->found, dim, m->coefficients);
  for (long c = 0; c < count; c++)
    for (long i = 0; i < dim; i++) r->series[(k * count + c) * dim + i] = m->coefficients[i * count + c];
  return 1;
}

/* Estimate the error of windows from *first to before `end`; *first becomes the first that is not estimated. */
int carry_errors(carrying *m, const equations *H, const error_tables *t, const actions *a, const error_settings *s,
                 const windows *w, const double *jumps, error_results *r, long *first, long end) {
  long dim = H->dim, rows = dim * m->each, coarse_from = *first;
  double *joint = r->joint;
  int bent = 0; /* whether the linear equation alone is solved from here on */
  set_parameters(&m->velocity, s->parameters, m->stride);
  set_parameters(&m->force, s->parameters, m->stride);
  set_parameters(&m->hessian, s->parameters, m->stride);
  for (long k = 0; k < a->terms; k++) {
    m->terms[k] = a->term[k];
    m->terms[k].factor *= s->scale[a->term[k].source] / s->scale[a->term[k].row];
  }
  memset(m->readout, 0, dim * t->columns * sizeof(double));
  for (long k = *first; k < end; k++) {
    *first = k;
    double h = w->edge[k + 1] - w->edge[k], length = fabs(h);
    r->mark[k] = residual(m, H, t, s, w, k, h, end > FEW);
    memcpy(m->before, joint, rows * sizeof(double));
    disturb_vectors(m, H, t, s, joint, k, length);
    /* The mean root is the typical size of the error, also if it has short peaks beside a pole. What is left of an
       inaccuracy behind a peak grows with the forces there, so that a peak counts twice. */
    double mean = r->history[0] / greater(fabs(w->edge[k] - w->edge[0]), TINY), typical = PASSING * mean * mean;
    double share = typical < r->history[1] ? typical / r->history[1] : 1.0, accuracy = s->accuracy * share * share;
    double size, last = INFINITY;
    const rule *rule;
    fill(m->bent, 0.0, dim * t->places);
    run(&m->hessian, m->z, m->times, t->places, m->curvature);
    for (;;) {
      rule = solve_window(m, H, t, a, s, w, joint, k, accuracy, &coarse_from);
      if (!rule) {
        memcpy(joint, m->before, rows * sizeof(double));
        return STUCK;
      }
      size = find_error(m, H, t, rule, s, h);
      if (bent || size <= accuracy) break;
      double change = beyond(m, H, t, a, s, length);
      int settles = change < last / 2;
      if (change <= accuracy * size || (!settles && change <= CURVED * size)) break;
      bent = !settles;
      if (bent) r->mark[k] |= BENT;
      coarse_from = k + 1 + KEPT;
      for (long c = 0; c < dim * t->places; c++) {
        double added = bent ? -m->bent[c] : m->disturbed[c];
        m->bent[c] += added;
        m->dz[c] -= added;
      }
      last = change;
    }
    r->history[0] += length * __builtin_sqrt(size);
    r->history[1] = size;
    for (long row = 0; row < rows; row++)
      joint[row] += h * dot(m->moved + row * rule->nodes, rule->end, rule->nodes);
    for (long i = 0; i < dim; i++) {
      long row = i * t->places;
      double moved = h * through(t, m->dz + row, m->pushed + row, h);
      joint[i * m->each] += (jumps[k * dim + i] - moved) / s->scale[i];
      if (m->shifted)
        joint[(i + 1) * m->each - 1] -= h * through(t, m->steady + row, m->steady_pushed + row, h) / s->scale[i];
    }
    for (long row = 0; row < rows; row++)
      if (!(fabs(joint[row]) <= LARGEST)) return LOST;
    if (!inside(m, H, t, rule, s, r, k, length)) return LOST;
  }
  *first = end;
  return DONE;
}
