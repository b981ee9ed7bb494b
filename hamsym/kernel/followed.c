/* Bounds on the error of a march by windows that are its own; lemma 26 of examples/guide/how_proofs_work.md.

   y is a polynomial near z^, made better by fixed-point iteration and one linear correction, and V one of fewer terms,
   near enough for sets that are thin. What is proven of them, the lemma of enclosures.h proves. */

#include "enclosures.h"
#include <stdlib.h>

#define TUBES 4           /* attempts at a tube, each of which doubles it */
#define SWEEPS 80         /* of an iteration to a fixed point */
#define ENOUGH 1e-8       /* last change of V and of a correction of y, which multiply what is small */
#define AROUND (8 * UNIT) /* of DG: its half length is an upper bound */
#define APART (4 * UNIT)  /* of a half length, and of what is left of a difference and of its low parts */

/* A program with its models, values at points, and what is put into them before a window. */
typedef struct {
  int64_t steps, still, constants, places, points;
  const series_step *step, *still_step;
  const int64_t *constant, *place, *result; /* registers of numbers, of what is still, and of results */
  const ball *number;
  const series_rows *rows;
  const double *values_of; /* of the terms of models at points, terms x points */
  double *values;          /* registers x points; constants are there */
} prepared;

/* A march and the state of its proof. */
typedef struct {
  int64_t dim, entries, inner, most, orders;
  const prepared *rates, *jacobian, *energy;
  const entry *entry;    /* of DG: with results, */
  const entry *placed;   /* and with registers in place of them */
  const double *signs;
  const double *integral;    /* at the points of y */
  const double *fewer_steps; /* between those of V, points x points x orders */
  const double *fewer;                     /* from values at the points of y to those at the points of V */
  /* z^ = z_a + a sum of features with readouts, windows x dim x inner; `trial` has room for it. */
  const series_rows *features, *trial;
  const double *readouts, *states, *edges;
  double origin;
  double *sizes;               /* of the components so far, dim */
  double *couplings;           /* sizes of the entries of DG over the last window, dim x dim */
  double *centre, *centre_low; /* of the set, dim */
  double *G, *R;               /* the set, dim x most and most */
  int64_t columns;
} march_proof;

/* y, and V with units, of a window, and room for what is computed of them. */
typedef struct {
  double *high, *low, *V, *units, *series, *values, *models, *D, *tube;
  double *squares; /* four of dim x dim */
} window;

/* Put the time into models; low parts become part of radii where models are not in twice float64. */
static void enter(const prepared *p, long dim, ball middle, ball slope, int twice) {
  const series_rows *rows = p->rows;
  long terms = rows->terms;
  for (long c = 0; c < p->constants; c++) {
    long row = p->constant[c];
    rows->high[row * terms] = p->number[c].high;
    rows->low[row * terms] = p->number[c].low;
    rows->radius[row] = p->number[c].radius;
    rows->length[row] = 1;
  }
  double *high = rows->high + dim * terms, *low = rows->low + dim * terms;
  high[0] = middle.high, high[1] = slope.high;
  low[0] = middle.low, low[1] = slope.low;
  rows->radius[dim] = up(middle.radius + slope.radius);
  rows->length[dim] = 2;
  run_series(p->still_step, p->still, rows, 1);
  for (long c = -1; c < p->places; c++) {
    long row = c < 0 ? dim : p->place[c];
    if (p->values) apply_table(p->values_of, rows->high + row * terms, rows->length[row], p->points, p->values + row * p->points);
  }
  for (long c = -1; c < p->constants + p->places && !twice; c++) {
    long row = c < 0 ? dim : c < p->constants ? p->constant[c] : p->place[c - p->constants];
    double *rest = rows->low + row * terms;
    rows->radius[row] = up(rows->radius[row] + norm_of(rest, 0, rows->length[row]));
    memset(rest, 0, terms * sizeof *rest);
  }
}

/* Put y into models over the tube, with what it has beyond their coefficients as radii. */
static void put_state(const prepared *p, const window *w, long dim, long terms) {
  const series_rows *rows = p->rows;
  long used = lesser(terms, rows->terms);
  for (long i = 0; i < dim; i++) {
    const double *high = w->high + i * terms, *low = w->low + i * terms;
    memcpy(rows->high + i * rows->terms, high, used * sizeof *high);
    memset(rows->low + i * rows->terms, 0, rows->terms * sizeof *low);
    rows->radius[i] = up(w->tube[i] + norm_of(high + used, 0, terms - used) + norm_of(low, 0, terms));
    rows->length[i] = used;
  }
}

/* The defect of y, from the centre: its low parts become those within half an ulp of high ones. */
static void bound_defect(const march_proof *m, ball slope, const window *w) {
  const series_rows *rows = m->rates->rows;
  long terms = rows->terms;
  for (long i = 0; i < m->dim; i++) {
    double *high = w->high + i * terms, *low = w->low + i * terms;
    ball begin = end_value(high, low, terms, -1);
    low[0] += (m->centre[i] - begin.high) + (m->centre_low[i] - begin.low);
    for (long k = 0; k < terms; k++) {
      pair sum = two_sum(high[k], low[k]);
      high[k] = sum.high, low[k] = sum.low;
    }
    memcpy(rows->high + i * terms, high, terms * sizeof *high);
    memcpy(rows->low + i * terms, low, terms * sizeof *low);
    rows->radius[i] = 0.0, rows->length[i] = terms;
  }
  hamsym_defects(m->rates->step, m->rates->steps, m->rates->result, rows, m->dim, &slope, w->series, w->D);
}

/* Guess y, V and units from z^; y is left in models with its defect. */
static int guess(const march_proof *m, ball slope, const window *w) {
  const prepared *rates = m->rates, *jacobian = m->jacobian;
  long dim = m->dim, terms = rates->rows->terms, fewer = jacobian->rows->terms;
  double half = fabs(slope.high), *shares = w->squares;
  for (long i = 0; i < dim; i++)
    apply_table(rates->rows->values, m->trial->high + i * m->trial->terms, terms, terms, rates->values + i * terms);
  if (hamsym_collocate(rates->step, rates->steps, rates->result, rates->values, terms, m->integral, m->centre, dim,
                       slope.high, SWEEPS) <= 0)
    return 0;
  memcpy(jacobian->values, rates->values, dim * terms * sizeof *w->high);
  run_values(jacobian->step, jacobian->steps, jacobian->values, terms);
  /* Units in which DG is nearly balanced; the caller has to know those of components at rest. */
  memset(m->couplings, 0, dim * dim * sizeof *m->couplings);
  for (const entry *e = m->placed; e < m->placed + m->entries; e++)
    if (e->i != e->j) m->couplings[e->i * dim + e->j] += row_size(jacobian->values + e->place * terms, terms);
  for (long i = 0; i < dim; i++) {
    m->sizes[i] = larger(row_size(rates->values + i * terms, terms), m->sizes[i]);
    w->units[i] = m->sizes[i];
    if (!(w->units[i] > 0 && w->units[i] < INFINITY)) return 0;
  }
  for (long i = 0; i < dim; i++)
    for (long j = 0; j < dim; j++)
      shares[i * dim + j] = m->couplings[i * dim + j] + (i == j ? 0.0 : 1e-3 / half * w->units[i] / w->units[j]);
  hamsym_balance(shares, dim, w->units);
  for (long i = 0; i < dim; i++) {
    int exponent;
    if (!(w->units[i] > 0 && w->units[i] < INFINITY)) return 0;
    frexp(w->units[i], &exponent);
    w->units[i] = ldexp(1.0, exponent); /* by which division is exact */
  }
  memset(w->low, 0, dim * terms * sizeof *w->low);
  for (long i = 0; i < dim; i++)
    apply_table(rates->rows->series, rates->values + i * terms, terms, terms, w->high + i * terms);
  bound_defect(m, slope, w);
  double *wanted = w->values, *found = wanted + dim * terms, rest[terms];
  for (long i = 0; i < dim; i++) {
    apply_table(rates->rows->values, w->series + i * (terms + 1), terms, terms, wanted + i * terms);
    for (long k = 0; k < terms; k++) wanted[i * terms + k] *= -1;
  }
  if (!iterate_correction(jacobian->values, m->placed, m->signs, m->entries, dim, m->integral, terms, half, wanted,
                          w->units, SWEEPS, ENOUGH, found))
    return 0;
  for (long i = 0; i < dim; i++) {
    apply_table(rates->rows->series, found + i * terms, terms, terms, rest);
    for (long k = 0; k < terms; k++) w->low[i * terms + k] += rest[k];
  }
  bound_defect(m, slope, w);
  double *coarse = w->values;
  for (const entry *e = m->placed; e < m->placed + m->entries; e++)
    apply_table(m->fewer, jacobian->values + e->place * terms, terms, fewer, coarse + e->place * fewer);
  return hamsym_tangents(coarse, m->placed, m->signs, m->entries, dim, dim, m->fewer_steps, jacobian->rows->series, fewer,
                         m->orders, half, w->units, ENOUGH, w->V);
}

/* Move the set over a window, which adds errors. */
static int move_set(march_proof *m, const window *w, const double *added) {
  long dim = m->dim, terms = m->jacobian->rows->terms, columns = m->columns, count = columns + dim;
  double *J = w->squares, *J_error = J + dim * dim, rest[dim];
  for (long k = 0; k < dim * dim; k++) {
    ball end = end_value(w->V + k * terms, 0, terms, 1);
    J[k] = end.high;
    J_error[k] = up(fabs(end.low) + end.radius);
  }
  double *moved = malloc((dim * m->most + dim * dim) * sizeof *moved), *boxed = moved + dim * m->most;
  if (!moved) return 0;
  memset(rest, 0, sizeof rest);
  int good = !columns || hamsym_moved_set(J, J_error, m->G, m->R, dim, dim, columns, 1, moved, rest);
  if (count > m->most) {
    good = good && hamsym_boxed_set(moved, m->R, w->units, dim, columns, 1, boxed, m->G);
    memcpy(m->R, m->G, dim * sizeof *m->R);
    memcpy(moved, boxed, dim * dim * sizeof *moved);
    columns = dim, count = 2 * dim;
  }
  for (long i = 0; i < dim; i++) {
    memcpy(m->G + i * count, moved + i * columns, columns * sizeof *moved);
    for (long c = 0; c < dim; c++) m->G[i * count + columns + c] = c == i;
    m->R[columns + i] = up(rest[i] + added[i]);
    good = good && m->R[columns + i] < INFINITY;
  }
  m->columns = count;
  free(moved);
  return good;
}

/* Prove a window: bounds on |z - y| in its tube; the set becomes that at its end. Returns 0 if there are none. */
static int prove_window(march_proof *m, ball slope, const window *w) {
  const prepared *jacobian = m->jacobian, *energy = m->energy;
  long dim = m->dim, terms = m->rates->rows->terms, fewer = jacobian->rows->terms, count = m->entries;
  double offset[dim], xi[dim], hull[dim], found[dim], d[dim], added[dim], norm;
  double *sizes = w->squares, *defect = sizes + dim * dim, *start_error = defect + dim * dim;
  double *derivative = start_error + dim * dim;
  double *models = w->models, *radii = models + count * fewer, half = fabs(slope.high) * (1 + APART);
  int64_t lengths[count];
  for (long i = 0; i < dim; i++) {
    ball begin = end_value(w->high + i * terms, w->low + i * terms, terms, -1);
    double gap = (begin.high - m->centre[i]) + (begin.low - m->centre_low[i]), size = 0.0;
    offset[i] = up(fabs(gap) + MIDDLE * (fabs(begin.high) + fabs(m->centre[i])) + begin.radius);
    for (long c = 0; c < m->columns; c++) size += fabs(m->G[i * m->columns + c]) * m->R[c];
    xi[i] = up(up(size) + offset[i]);
  }
  for (long i = 0; i < dim; i++) {
    double size = 0.0, beside = 0.0;
    for (long c = 0; c < dim; c++) {
      double large = sizes[i * dim + c] = norm_of(w->V + (i * dim + c) * fewer, 0, fewer);
      size += large * xi[c];
      beside += large * offset[c];
    }
    hull[i] = up(size);
    added[i] = beside;
    w->tube[i] = 1.5 * (hull[i] + 2 * w->D[i]) + 4 * UNIT * UNIT * m->sizes[i] + SMALL;
  }
  lemma step = {dim, dim, fewer, count, models, radii, lengths, m->entry, m->signs, xi, hull, w->V,
                sizes, defect, start_error, w->D, half, w->units};
  int accepted = 0;
  for (int attempt = 0; attempt < TUBES && !accepted; attempt++) {
    put_state(jacobian, w, dim, terms);
    run_series(jacobian->step, jacobian->steps, jacobian->rows, 0);
    for (long e = 0; e < count; e++) {
      long row = m->placed[e].place, length = jacobian->rows->length[row];
      memcpy(models + e * fewer, jacobian->rows->high + row * fewer, length * sizeof *models);
      memset(models + e * fewer + length, 0, (fewer - length) * sizeof *models);
      radii[e] = up(jacobian->rows->radius[row] + AROUND * norm_of(models + e * fewer, 0, length));
      lengths[e] = length;
    }
    if (!hamsym_flow_defects(&step, defect, start_error) || !hamsym_lemma(&step, found, d, derivative, &norm)) return 0;
    accepted = 1;
    for (long i = 0; i < dim; i++) accepted = accepted && found[i] < w->tube[i];
    for (long i = 0; i < dim && !accepted; i++) w->tube[i] = larger(2 * found[i], w->tube[i]);
  }
  if (!accepted) return 0;
  /* Derivatives of H may be smooth where H is not, as those of acot(x) at 0. */
  put_state(energy, w, dim, terms);
  run_series(energy->step, energy->steps, energy->rows, 0);
  if (!(energy->rows->radius[*energy->result] < INFINITY)) return 0;
  for (long i = 0; i < dim; i++) {
    ball end = end_value(w->high + i * terms, w->low + i * terms, terms, 1);
    m->centre[i] = end.high, m->centre_low[i] = end.low;
    added[i] = up(added[i] + d[i] + w->D[i] + end.radius);
    w->tube[i] = found[i];
  }
  return move_set(m, w, added);
}

/* z^ - y, dim x terms, and bounds on the rest of z^ - z. */
static void compare(const march_proof *m, const window *w, double *apart, double *radius) {
  const series_rows *trial = m->trial;
  long terms = m->rates->rows->terms;
  for (long i = 0; i < m->dim; i++) {
    const double *high = trial->high + i * trial->terms, *low = trial->low + i * trial->terms;
    double total = trial->radius[i] + w->tube[i];
    for (long k = 0; k < terms; k++) {
      pair less = two_sum(high[k], -w->high[i * terms + k]);
      double value = less.high + (less.low + (low[k] - w->low[i * terms + k]));
      apart[i * terms + k] = value;
      total += APART * (fabs(value) + fabs(less.low) + fabs(low[k]) + fabs(w->low[i * terms + k]));
    }
    radius[i] = up(total + norm_of(high + terms, low + terms, trial->length[i] - terms));
  }
}

/* Prove windows from the first to the last one: coefficients of z^ - y, windows x dim x terms, and bounds on the rest
   of z^ - z, windows x dim. Returns how many were proven. */
EXPORTED int64_t hamsym_follow(march_proof *m, int64_t first, int64_t last, double *apart, double *radius) {
  long dim = m->dim, terms = m->rates->rows->terms, fewer = m->jacobian->rows->terms, number = first, registers = dim;
  for (long e = 0; e < m->entries; e++) registers = m->placed[e].place >= registers ? m->placed[e].place + 1 : registers;
  long of_values = registers * fewer + 2 * dim * terms, of_models = dim * dim * fewer + m->entries * (fewer + 1);
  double *memory = malloc((dim * (3 * terms + 4 + dim * (fewer + 4)) + of_values + of_models) * sizeof *memory);
  if (!memory) return 0;
  window w = {.high = memory, .low = memory + dim * terms, .series = memory + 2 * dim * terms};
  w.D = w.series + dim * (terms + 1), w.tube = w.D + dim, w.units = w.tube + dim, w.V = w.units + dim;
  w.values = w.V + dim * dim * fewer, w.models = w.values + of_values, w.squares = w.models + of_models;
  for (; number < last; number++, apart += dim * terms, radius += dim) {
    double begin = m->edges[number], end = m->edges[number + 1];
    ball middle = add(ball_of(m->origin), scaled(add(ball_of(begin), ball_of(end)), 0.5));
    pair length = two_sum(end, -begin);
    ball slope = scaled((ball){length.high, length.low, 0.0}, 0.5);
    if (!(UNIT * fabs(slope.high) >= slope.radius)) break; /* too short for relative bounds */
    enter(m->rates, dim, middle, slope, 1);
    enter(m->jacobian, dim, middle, slope, 0);
    enter(m->energy, dim, middle, slope, 0);
    hamsym_dense(m->readouts + number * dim * m->inner, m->states + number * dim, dim, m->inner, m->features, m->trial);
    if (!guess(m, slope, &w) || !prove_window(m, slope, &w)) break;
    compare(m, &w, apart, radius);
  }
  free(memory);
  return number - first;
}
