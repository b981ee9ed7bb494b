#include "discs.h"
#include "functions.h"
#include <stdlib.h>

#define CUT (16 * EPS) /* last coefficients of a series that are its roundings, relative to their sum */

/* Doubles that rows of discs for either of two programs need. */
long discs_size(const program *one, const program *other) {
  long rows = all_rows(one), more = all_rows(other);
  return (rows > more ? rows : more) * 2 * DISCS;
}

/* Discs of a trial solution, dim x terms coefficients, and of the time: the first rows of programs. `memory` has room
   for dim x DISCS numbers. */
void trial_discs(const disc_tables *t, double *series, long dim, double start, double h, double *memory, disc *row) {
  long terms = t->terms;
  for (long i = 0; i < dim; i++) {
    double *own = series + i * terms, total = 0.0;
    for (long k = 0; k < terms; k++) total += fabs(own[k]);
    for (long k = terms - 1; k > 0 && fabs(own[k]) <= CUT * total; k--) own[k] = 0.0;
  }
  products(t->middle, terms, DISCS, series, dim, memory);
  for (long i = 0; i < dim; i++) memcpy(row[i].middle, memory + i * DISCS, sizeof row->middle);
  for (long k = 0; k < dim * terms; k++) series[k] = fabs(series[k]);
  products(t->extent, terms, DISCS, series, dim, memory);
  for (long i = 0; i < dim; i++) memcpy(row[i].radius, memory + i * DISCS, sizeof row->radius);
  for (long d = 0; d < DISCS; d++) row[dim].middle[d] = start + h * t->place[d];
  fill(row[dim].radius, fabs(h) * t->radius, DISCS);
}

static void multiply(const disc *a, const disc *b, disc *out) {
  for (long d = 0; d < DISCS; d += LANES) {
    vw x = load(a->middle + d), y = load(b->middle + d), r = load(a->radius + d), s = load(b->radius + d);
    store(out->radius + d, magnitudes(x) * s + magnitudes(y) * r + r * s);
    store(out->middle + d, x * y);
  }
}

/* The range in which a radius is below the middle, so that zero is outside; infinite elsewhere. */
INLINE double if_positive(double middle, double radius, double found) { return middle > radius ? found : INFINITY; }

static void reciprocal(const disc *a, disc *out) {
  for (long d = 0; d < DISCS; d++) {
    double x = a->middle[d], r = a->radius[d], square = (fabs(x) - r) * (fabs(x) + r);
    out->middle[d] = x / square;
    out->radius[d] = if_positive(fabs(x), r, r / square);
  }
}

static void root(const disc *a, disc *out) {
  for (long d = 0; d < DISCS; d++) {
    double x = a->middle[d], r = a->radius[d], middle = sqrt(x);
    out->middle[d] = middle;
    out->radius[d] = if_positive(x, r, middle - sqrt(x - r));
  }
}

/* sinh(r) and cosh(r) - 1. */
static void grow(const disc *a, double *sinh_of, double *cosh_of) {
  double e[DISCS];
  hamsym_expm1(a->radius, e, DISCS);
  for (long d = 0; d < DISCS; d++) {
    sinh_of[d] = (e[d] + e[d] / (1.0 + e[d])) / 2;
    cosh_of[d] = e[d] * (e[d] / (1.0 + e[d])) / 2;
  }
}

/* Of sin, cos, sinh or cosh: f(x + w) = f(x) cosh(w) + f'(x) sinh(w), or the same with cos and sin. */
static void turn(const disc *a, const double *value, const double *slope, disc *out) {
  double sinh_of[DISCS], cosh_of[DISCS];
  grow(a, sinh_of, cosh_of);
  for (long d = 0; d < DISCS; d++) {
    out->middle[d] = value[d];
    out->radius[d] = fabs(value[d]) * cosh_of[d] + fabs(slope[d]) * sinh_of[d];
  }
}

static void exponential(const disc *a, disc *out) {
  double most[DISCS];
  for (long d = 0; d < DISCS; d++) most[d] = a->middle[d] + a->radius[d];
  hamsym_exp(most, most, DISCS);
  hamsym_exp(a->middle, out->middle, DISCS);
  for (long d = 0; d < DISCS; d++) out->radius[d] = most[d] - out->middle[d];
}

static void logarithm(const disc *a, disc *out) {
  double middle[DISCS], share[DISCS];
  hamsym_log(a->middle, middle, DISCS);
  for (long d = 0; d < DISCS; d++) share[d] = -a->radius[d] / a->middle[d];
  hamsym_log1p(share, share, DISCS);
  for (long d = 0; d < DISCS; d++) {
    out->radius[d] = if_positive(a->middle[d], a->radius[d], -share[d]);
    out->middle[d] = middle[d];
  }
}

/* x**n for a number n: the coefficients of (1 + w)**n are at most those of (1 - w)**-|n|. */
static void power(const disc *a, const disc *n, disc *out) {
  double middle[DISCS], share[DISCS], size[DISCS];
  hamsym_pow(a->middle, n->middle, middle, DISCS);
  for (long d = 0; d < DISCS; d++) {
    share[d] = 1.0 - a->radius[d] / a->middle[d];
    size[d] = -fabs(n->middle[d]);
  }
  hamsym_pow(share, size, share, DISCS);
  for (long d = 0; d < DISCS; d++) {
    double radius = n->radius[d] == 0.0 ? middle[d] * (share[d] - 1.0) : INFINITY;
    out->radius[d] = if_positive(a->middle[d], a->radius[d], radius);
    out->middle[d] = middle[d];
  }
}

/* Functions with a kink or a jump are analytic where one of their branches is chosen in the whole disc. */
static void choose_branch(enum operation operation, const disc *a, const disc *b, disc *out) {
  int one = operation == MAGNITUDE || operation == SIGN;
  for (long d = 0; d < DISCS; d++) {
    double difference = one ? a->middle[d] : a->middle[d] - b->middle[d];
    double apart = one ? a->radius[d] : a->radius[d] + b->radius[d];
    const disc *chosen = one || (difference > 0.0) == (operation == MOST) ? a : b;
    double middle = chosen->middle[d], radius = operation == SIGN ? 0.0 : chosen->radius[d];
    if (operation == SIGN) middle = difference > 0.0 ? 1.0 : -1.0;
    if (operation == MAGNITUDE) middle = fabs(middle);
    out->middle[d] = middle;
    out->radius[d] = if_positive(fabs(difference), apart, radius);
  }
}

static void perform(enum operation operation, const disc *a, const disc *b, disc *out) {
  double one[DISCS], other[DISCS];
  disc found;
  switch (operation) {
    case COPY: *out = *a; break;
    case NEGATIVE:
      for (long d = 0; d < DISCS; d++) out->middle[d] = -a->middle[d];
      memcpy(out->radius, a->radius, sizeof out->radius);
      break;
    case ADD: case SUBTRACT:
      perform_rows(operation, a->middle, b->middle, out->middle, DISCS);
      perform_rows(ADD, a->radius, b->radius, out->radius, DISCS);
      break;
    case MULTIPLY: multiply(a, b, out); break;
    case RECIPROCAL: reciprocal(a, out); break;
    case ROOT: root(a, out); break;
    case SIN: case COS:
      hamsym_sin_cos(a->middle, one, other, DISCS);
      turn(a, operation == SIN ? one : other, operation == SIN ? other : one, out);
      break;
    case SINH: case COSH:
      hamsym_sinh(a->middle, one, DISCS);
      hamsym_cosh(a->middle, other, DISCS);
      turn(a, operation == SINH ? one : other, operation == SINH ? other : one, out);
      break;
    case EXP: exponential(a, out); break;
    case LOG: logarithm(a, out); break;
    case POWER: power(a, b, out); break;
    case ATAN: /* its slope is 1/(1 + x**2) */
      multiply(a, a, &found);
      for (long d = 0; d < DISCS; d++) found.middle[d] += 1.0;
      reciprocal(&found, &found);
      hamsym_atan(a->middle, out->middle, DISCS);
      for (long d = 0; d < DISCS; d++) out->radius[d] = a->radius[d] * (fabs(found.middle[d]) + found.radius[d]);
      break;
    case MAGNITUDE: case SIGN: case LEAST: case MOST: choose_branch(operation, a, b, out); break;
    default:
      fill(out->middle, 0.0, DISCS);
      fill(out->radius, INFINITY, DISCS);
  }
}

/* Bounds of the results of a program in all discs, infinite or NaN where there are none. */
void run_discs(const program *p, const double *parameters, disc *row, double *bounds) {
  for (long k = 0; k < p->results; k++) bounds[k] = INFINITY;
  if (p->function) return;
  disc *own = row + p->dim + 1;
  for (long k = 0; k < p->parameters + p->numbers; k++, own++) {
    fill(own->middle, k < p->parameters ? parameters[k] : p->number[k - p->parameters], DISCS);
    fill(own->radius, 0.0, DISCS);
  }
  for (const step *s = p->step, *end = s + p->steps; s < end; s++)
    perform(s->operation, row + s->first, row + s->second, row + s->out);
  for (long k = 0; k < p->results; k++, own++) {
    vw most = {0.0};
    for (long d = 0; d < DISCS; d += LANES)
      most = larger_lanes(magnitudes(magnitudes(load(own->middle + d)) + load(own->radius + d)), most);
    bounds[k] = largest_lane(most);
  }
}

/* Bounds of the results of a program in discs of the state and the time, (dim + 1) x 2 x DISCS. */
EXPORTED int64_t hamsym_discs(const program *p, const double *inputs, const double *parameters, double *bounds) {
  disc *row = calloc(all_rows(p), sizeof(disc));
  if (!row) return 0;
  memcpy(row, inputs, (p->dim + 1) * sizeof(disc));
  run_discs(p, parameters, row, bounds);
  free(row);
  return 1;
}
