#include "models.h"
#include "functions.h"
#include <stdlib.h>

#define MIDDLE (PLACES / 2)
#define UNIT (4 * EPS)             /* rounding of values by one operation, relative to their size */
#define BETWEEN 1.3807442564004246 /* a polynomial exceeds its values by this factor at most (Ehlich & Zeller 1964) */
#define PI 3.141592653589793
#define SMALLEST 5e-324            /* what underflows to zero */
#define LEBESGUE 3.7                /* a polynomial through values at the places is larger by this factor at most */
#define MOST_SHARES 4.0             /* of the limit of a window, that all its parts may use; see hamsym/bounds/residual.py */
#define HIDDEN 0.05                /* of the limit, between the places: the estimated error has what is at the places */
#define ROUNDED 4.0                /* times the rounding of models that is left out of a residual */

typedef void row_function(const double *x, double *out, long n);

/* 0 times infinity, of bounds, is 0. */
INLINE double product(double x, double y) { double found = x * y; return found == found ? found : 0.0; }
/* The larger and the smaller of two numbers, or the one that is not NaN. */
INLINE double upper(double x, double y) { return x > y || y != y ? x : y; }
INLINE double lower(double x, double y) { return x < y || y != y ? x : y; }
/* The smaller of two numbers; NaN if one is. */
INLINE double smaller(double x, double y) { return x < y || x != x ? x : y; }

static double size_of(const double *value) { return row_size(value, PLACES); }
static double largest_of(const model *g) { return BETWEEN * size_of(g->value); }

/* Sum of the magnitudes of coefficients that are not roundings. */
static double sum_of(const double *coefficient, long n, double rounding) {
  double total = 0.0;
  for (long k = 0; k < n; k++) total += larger(fabs(coefficient[k]) - rounding, 0.0);
  return total;
}

/* -- even and odd parts --

   The places are symmetric: coefficients of even degrees come from sums of two values, those of odd degrees from
   differences, by half of the products. Of both, the first HIGH numbers are the even ones. */

INLINE v4 reversed(v4 x) { return (v4){x[3], x[2], x[1], x[0]}; }

INLINE void fold(const double *value, double number, double *out) {
  for (int c = 0; c < HIGH; c += 4) {
    v4 one = load4(value + c) - number, other = reversed(load4(value + PLACES - 4 - c)) - number;
    store4(out + c, one + other);
    store4(out + HIGH + c, one - other);
  }
}

INLINE void unfold(const double *even, const double *odd, double *value) {
  for (int c = 0; c < HIGH; c += 4) {
    store4(value + c, load4(even + c) + load4(odd + c));
    store4(value + PLACES - 4 - c, reversed(load4(even + c) - load4(odd + c)));
  }
}

/* Products of both parts and tables from n numbers each to k. */
INLINE void apply_parts(const double *table, long n, long k, const double *parts, double *out) {
  for (long column = 0; column < k; column += 16) {
    vw even[16 / LANES] = {{0.0}}, odd[16 / LANES] = {{0.0}};
    for (long m = 0; m < n; m++)
      for (int j = 0; j < 16 / LANES; j++) {
        const double *row = table + m * k + column + LANES * j;
        even[j] += parts[m] * load(row);
        odd[j] += parts[n + m] * load(row + n * k);
      }
    memcpy(out + column, even, sizeof even);
    memcpy(out + k + column, odd, sizeof odd);
  }
}

/* Truncate a polynomial to DEGREE; return the bound on what is lost. */
static double truncate_values(const model_tables *t, double *value, double rounding) {
  double parts[PLACES], high[HIGH], lost[PLACES], rest[PLACES];
  double allowed = rounding + UNIT * size_of(value);
  /* Without the constant, which has no high coefficients but those of its roundings. */
  fold(value, value[MIDDLE], parts);
  apply_parts(t->high, HIGH, HIGH / 2, parts, high);
  apply_parts(t->values_of_high, HIGH / 2, HIGH, high, lost);
  unfold(lost, lost + HIGH, rest);
  for (int c = 0; c < PLACES; c++) value[c] -= rest[c];
  return sum_of(high, HIGH, allowed);
}

/* Values of the derivative, without coefficients that are roundings. */
static void slopes_of(const model_tables *t, const model *g, double *out) {
  double parts[PLACES], low[HIGH], slopes[PLACES];
  double allowed = g->rounding + UNIT * size_of(g->value);
  fold(g->value, g->value[MIDDLE], parts);
  apply_parts(t->low, HIGH, HIGH / 2, parts, low);
  for (int k = 0; k < HIGH; k++) low[k] = fabs(low[k]) > allowed ? low[k] : 0.0;
  apply_parts(t->slopes_of_low, HIGH / 2, HIGH, low, slopes);
  /* Even polynomials have odd slopes. */
  unfold(slopes + HIGH, slopes, out);
}

/* Bound the difference of a polynomial and the integral of its supposed slopes, both without their values in
   the middle of the interval. */
static double defect_of(const model_tables *t, const double *value, const double *slope, double rounding) {
  double own[PLACES], slopes[PLACES], parts[2 * PLACES], rest[PLACES];
  fold(value, value[MIDDLE], own);
  fold(slope, 0.0, slopes);
  /* Coefficients of odd degrees, from even slopes and odd values, then those of even degrees. */
  memcpy(parts, slopes, HIGH * sizeof(double));
  memcpy(parts + HIGH, own + HIGH, HIGH * sizeof(double));
  memcpy(parts + PLACES, slopes + HIGH, HIGH * sizeof(double));
  memcpy(parts + PLACES + HIGH, own, HIGH * sizeof(double));
  apply_parts(t->defects, PLACES, HIGH, parts, rest);
  double allowed = rounding + UNIT * (size_of(value) + size_of(slope));
  /* The constant makes the difference 0 in the middle. */
  return sum_of(rest, PLACES, allowed) + larger(fabs(dot(rest, t->at_middle, PLACES)) - allowed, 0.0);
}

/* Bound a polynomial by the sum of its coefficients. */
static double total_of(const model_tables *t, const double *value, double rounding) {
  double parts[PLACES], coefficient[PLACES];
  fold(value, 0.0, parts);
  apply_parts(t->coefficients, HIGH, HIGH, parts, coefficient);
  return sum_of(coefficient, PLACES, rounding);
}

/* Complete a model with values: its range is that of the polynomial, or the given one where it is smaller. A
   polynomial that is further from the function than the middle of the range is replaced by it. */
static void tighten(model *g, double error, double rounding, double low, double high) {
  double top = g->value[0], bottom = g->value[0];
  for (int c = 1; c < PLACES; c++) {
    top = larger(g->value[c], top);
    bottom = smaller(g->value[c], bottom);
  }
  double middle = (top + bottom) / 2, half = BETWEEN * (top - bottom) / 2 + error;
  /* Where the polynomial is NaN, the given range stays. */
  g->low = upper(low, middle - half);
  g->high = lower(high, middle + half);
  half = (g->high - g->low) / 2;
  if (!(error <= half)) {
    int finite = isfinite(half);
    fill(g->value, finite ? g->low + half : 0.0, PLACES);
    error = finite ? greater(half, 0.0) : INFINITY;
    rounding = 0.0;
  }
  rounding += UNIT * larger(fabs(top), fabs(bottom));
  g->error = error;
  g->rounding = rounding == rounding ? rounding : 0.0;
  g->constant = 0;
}

static void make_constant(model *g, double number) {
  fill(g->value, number, PLACES);
  g->error = g->rounding = 0.0;
  g->low = g->high = number;
  g->constant = 1;
}

/* A model of a function of which only the range is known. */
static void make_range(model *g, double low, double high) {
  fill(g->value, NAN, PLACES);
  tighten(g, INFINITY, 0.0, low, high);
}

/* -- sums and products ------------------------------------------------------------------------- */

static void negative(const model *g, model *out) {
  model found = *g;
  for (int c = 0; c < PLACES; c++) found.value[c] = -g->value[c];
  found.low = -g->high;
  found.high = -g->low;
  *out = found;
}

static void shifted(const model *g, double number, model *out) {
  *out = *g;
  for (int c = 0; c < PLACES; c++) out->value[c] += number;
  out->rounding += UNIT * size_of(out->value);
  out->low += number;
  out->high += number;
}

static void scaled(const model *g, double number, model *out) {
  *out = *g;
  for (int c = 0; c < PLACES; c++) out->value[c] *= number;
  out->error *= fabs(number);
  out->rounding *= fabs(number);
  double one = g->low * number, other = g->high * number;
  out->low = smaller(one, other);
  out->high = larger(one, other);
}

static void add(const model *a, const model *b, model *out) {
  if (b->constant) { shifted(a, b->low, out); return; }
  if (a->constant) { shifted(b, a->low, out); return; }
  for (int c = 0; c < PLACES; c++) out->value[c] = a->value[c] + b->value[c];
  tighten(out, a->error + b->error, a->rounding + b->rounding, a->low + b->low, a->high + b->high);
}

static void multiply(const model_tables *t, const model *a, const model *b, model *out) {
  if (b->constant) { scaled(a, b->low, out); return; }
  if (a->constant) { scaled(b, a->low, out); return; }
  double rounding = product(a->rounding, size_of(b->value)) + product(b->rounding, size_of(a->value));
  double error = product(a->error, largest_of(b)) + product(b->error, largest_of(a) + a->error), low, high;
  if (a == b) {
    double largest = larger(a->high, -a->low), smallest = larger(larger(a->low, -a->high), 0.0);
    low = smallest * smallest;
    high = largest * largest;
  } else {
    double one = product(a->low, b->low), two = product(a->low, b->high);
    double three = product(a->high, b->low), four = product(a->high, b->high);
    low = smaller(smaller(one, two), smaller(three, four));
    high = larger(larger(one, two), larger(three, four));
  }
  for (int c = 0; c < PLACES; c++) out->value[c] = a->value[c] * b->value[c];
  error += truncate_values(t, out->value, rounding);
  tighten(out, error, rounding, low, high);
}

/* -- functions --------------------------------------------------------------------------------- */

/* Whether a function leaves a domain; its range may do so although the function does not. */
static int leaves(const model *g, double lowest, double highest) {
  double slack = g->error + g->rounding;
  int beyond = g->high < lowest || g->low > highest;
  for (int c = 0; c < PLACES; c++) beyond |= g->value[c] < lowest - slack || g->value[c] > highest + slack;
  return beyond;
}

/* 1/g; unbounded where the range of g has a zero inside. */
static void reciprocal(const model_tables *t, const model *g, model *out) {
  int positive = g->low >= 0.0, negative = g->high <= 0.0;
  double value[PLACES];
  for (int c = 0; c < PLACES; c++) value[c] = 1.0 / g->value[c];
  double exact = size_of(value), share = product(g->rounding, exact); /* relative */
  truncate_values(t, value, share * exact);
  double smallest = positive ? g->low : -g->high, size = 0.0, rest[PLACES];
  for (int c = 0; c < PLACES; c++) {
    rest[c] = 1.0 - g->value[c] * value[c];
    size = larger(fabs(g->value[c]) * fabs(value[c]), size);
  }
  double defect = total_of(t, rest, share + UNIT * (1.0 + size)) + product(g->error, BETWEEN * size_of(value));
  double error = smallest > 0.0 ? defect / smallest : INFINITY;
  int bounded = positive || negative;
  double low = bounded && g->high != 0.0 ? 1.0 / g->high : -INFINITY;
  double high = bounded && g->low != 0.0 ? 1.0 / g->low : INFINITY;
  memcpy(out->value, value, sizeof value);
  tighten(out, error, share * exact, low, high);
}

/* sqrt(g), where g is not negative. */
static void root(const model_tables *t, const model *g, model *out) {
  double low = sqrt(larger(g->low, 0.0)), high = sqrt(larger(g->high, 0.0));
  if (leaves(g, 0.0, INFINITY)) high = INFINITY;
  double value[PLACES], rest[PLACES], least = INFINITY;
  for (int c = 0; c < PLACES; c++) {
    value[c] = sqrt(larger(g->value[c], 0.0));
    least = smaller(value[c], least);
  }
  double rounding = least > 0.0 ? g->rounding / (2 * least) : 0.0;
  truncate_values(t, value, rounding);
  for (int c = 0; c < PLACES; c++) rest[c] = g->value[c] - value[c] * value[c];
  double defect = total_of(t, rest, g->rounding + UNIT * size_of(g->value)) + g->error;
  memcpy(out->value, value, sizeof value);
  tighten(out, low > 0.0 ? defect / low : INFINITY, rounding, low, high);
}

/* exp(g), from the equation f' = g' f. */
static void exponential(const model_tables *t, const model *g, model *out) {
  double value[PLACES], rate[PLACES], slope[PLACES];
  hamsym_exp(g->value, value, PLACES);
  double rounding = product(g->rounding, size_of(value)), exact = value[MIDDLE];
  truncate_values(t, value, rounding);
  double low = value_at(hamsym_exp, g->low), high = value_at(hamsym_exp, g->high);
  /* With w = f(p) - q the defect is that of w = w_0 + integral of p' w (Gronwall). */
  slopes_of(t, g, rate);
  for (int c = 0; c < PLACES; c++) slope[c] = rate[c] * value[c];
  double defect = defect_of(t, value, slope, rounding), start = fabs(exact - value[MIDDLE]) + SMALLEST;
  double growth = value_at(hamsym_exp, g->high - g->low + 2 * g->error);
  double error = growth * start + defect * (1.0 + 2.0 * BETWEEN * size_of(rate) * growth);
  error += product(high, value_at(hamsym_expm1, g->error));
  memcpy(out->value, value, sizeof value);
  tighten(out, error, rounding, low, high);
}

/* Whether an interval holds one of the places peak + 2 pi k; a hair wider, since they are rounded. */
static int has_turn(double low, double high, double peak) {
  double turn = 2 * PI, hair = 1e-9;
  return floor((high + hair - peak) / turn) >= ceil((low - hair - peak) / turn);
}

/* Range of a sine or a cosine, which is 1 at `peak`. */
static void periodic_range(row_function *function, double peak, const model *g, double *low, double *high) {
  if (!(isfinite(g->low) && isfinite(g->high))) {
    *low = -1.0;
    *high = 1.0;
    return;
  }
  double one = value_at(function, g->low), other = value_at(function, g->high);
  *low = has_turn(g->low, g->high, peak + PI) ? -1.0 : lower(one, other);
  *high = has_turn(g->low, g->high, peak) ? 1.0 : upper(one, other);
}

/* sin(g) and cos(g), from the rotation (sin, cos)' = g' (cos, -sin); either may be left out. */
static void circular(const model_tables *t, const model *g, model *sine, model *cosine) {
  double s[PLACES], c[PLACES], rate[PLACES], slope[PLACES], low, high;
  hamsym_sin_cos(g->value, s, c, PLACES);
  double at_s = s[MIDDLE], at_c = c[MIDDLE];
  slopes_of(t, g, rate);
  truncate_values(t, s, g->rounding);
  truncate_values(t, c, g->rounding);
  for (int k = 0; k < PLACES; k++) slope[k] = rate[k] * c[k];
  double one = defect_of(t, s, slope, g->rounding);
  for (int k = 0; k < PLACES; k++) slope[k] = -rate[k] * s[k];
  double other = defect_of(t, c, slope, g->rounding);
  double defect = sqrt(one * one + other * other);
  double first = at_s - s[MIDDLE], second = at_c - c[MIDDLE];
  double error = sqrt(first * first + second * second) + defect * (1.0 + 2.0 * BETWEEN * size_of(rate)) + g->error;
  model argument = *g;
  if (sine) {
    periodic_range(hamsym_sin, PI / 2, &argument, &low, &high);
    memcpy(sine->value, s, sizeof s);
    tighten(sine, error, argument.rounding, low, high);
  }
  if (cosine) {
    periodic_range(hamsym_cos, 0.0, &argument, &low, &high);
    memcpy(cosine->value, c, sizeof c);
    tighten(cosine, error, argument.rounding, low, high);
  }
}

static void tangent(const model_tables *t, const model *g, model *out) {
  model sine, cosine, inverse;
  circular(t, g, &sine, &cosine);
  reciprocal(t, &cosine, &inverse);
  multiply(t, &sine, &inverse, out);
}

/* f(g) for a function that grows between two numbers, from a model of f'(g): with p the polynomial of g, f(p)
   differs from its value in the middle by the integral of f'(p) p'. */
static void grown(const model_tables *t, const model *g, row_function *function, const model *slope, double lowest,
                  double highest, model *out) {
  double value[PLACES], rate[PLACES], low = -INFINITY, high = INFINITY;
  function(g->value, value, PLACES);
  if (!leaves(g, lowest, highest)) {
    low = value_at(function, larger(g->low, lowest));
    high = value_at(function, smaller(g->high, highest));
  }
  double rounding = product(g->rounding, size_of(slope->value)), exact = value[MIDDLE];
  truncate_values(t, value, rounding);
  slopes_of(t, g, rate);
  double missed = 2 * product(slope->error, BETWEEN * size_of(rate));
  for (int c = 0; c < PLACES; c++) rate[c] *= slope->value[c];
  double error = fabs(exact - value[MIDDLE]) + defect_of(t, value, rate, rounding) + missed;
  error += product(g->error, larger(fabs(slope->low), fabs(slope->high)));
  memcpy(out->value, value, sizeof value);
  tighten(out, error, rounding, low, high);
}

/* factor g^2 + number */
static void square_plus(const model_tables *t, const model *g, double factor, double number, model *out) {
  model square;
  multiply(t, g, g, &square);
  scaled(&square, factor, &square);
  shifted(&square, number, out);
}

static void reciprocal_root(const model_tables *t, const model *g, model *out) {
  model found;
  root(t, g, &found);
  reciprocal(t, &found, out);
}

static void inverse_function(const model_tables *t, enum operation operation, const model *g, model *out) {
  model inner, slope;
  switch (operation) {
    case LOG:
      reciprocal(t, g, &slope);
      grown(t, g, hamsym_log, &slope, 0.0, INFINITY, out);
      break;
    case ATAN:
      square_plus(t, g, 1.0, 1.0, &inner);
      reciprocal(t, &inner, &slope);
      grown(t, g, hamsym_atan, &slope, -INFINITY, INFINITY, out);
      break;
    case ASINH:
      square_plus(t, g, 1.0, 1.0, &inner);
      reciprocal_root(t, &inner, &slope);
      grown(t, g, hamsym_asinh, &slope, -INFINITY, INFINITY, out);
      break;
    case ACOSH:
      square_plus(t, g, 1.0, -1.0, &inner);
      reciprocal_root(t, &inner, &slope);
      grown(t, g, hamsym_acosh, &slope, 1.0, INFINITY, out);
      break;
    case ATANH:
      square_plus(t, g, -1.0, 1.0, &inner);
      reciprocal(t, &inner, &slope);
      grown(t, g, hamsym_atanh, &slope, -1.0, 1.0, out);
      break;
    case ERF:
      square_plus(t, g, -1.0, 0.0, &inner);
      exponential(t, &inner, &slope);
      scaled(&slope, 2.0 / sqrt(PI), &slope);
      grown(t, g, hamsym_erf, &slope, -INFINITY, INFINITY, out);
      break;
    default: /* ASIN and ACOS */
      square_plus(t, g, -1.0, 1.0, &inner);
      reciprocal_root(t, &inner, &slope);
      grown(t, g, hamsym_asin, &slope, -1.0, 1.0, out);
      if (operation != ACOS) break;
      negative(out, out);
      shifted(out, PI / 2, out);
  }
}

static void hyperbolic(const model_tables *t, enum operation operation, const model *g, model *out) {
  model first, second;
  double low = g->low, high = g->high;
  if (operation == TANH) { /* 1 - 2/(1 + exp(2 g)) */
    scaled(g, 2.0, &first);
    exponential(t, &first, &second);
    shifted(&second, 1.0, &first);
    reciprocal(t, &first, &second);
    scaled(&second, -2.0, &first);
    shifted(&first, 1.0, out);
    tighten(out, out->error, out->rounding, value_at(hamsym_tanh, low), value_at(hamsym_tanh, high));
    return;
  }
  negative(g, &first);
  exponential(t, &first, &second);
  exponential(t, g, &first);
  if (operation == SINH) negative(&second, &second);
  add(&first, &second, out);
  scaled(out, 0.5, out);
  if (operation == SINH)
    tighten(out, out->error, out->rounding, value_at(hamsym_sinh, low), value_at(hamsym_sinh, high));
}

static void scalar_power(double *ends, double exponent) {
  double base[8], power[8];
  for (int c = 0; c < 8; c++) base[c] = larger(ends[c % 2], 0.0);
  fill(power, exponent, 8);
  hamsym_pow(base, power, base, 8);
  ends[0] = base[0];
  ends[1] = base[1];
}

/* g**exponent, from the equation f' = exponent g'/g f: the logarithm would lose digits. */
static void number_power(const model_tables *t, const model *g, double exponent, model *out) {
  double size = fabs(exponent), value[PLACES], power[PLACES], slope[PLACES], rate[PLACES], least = INFINITY;
  for (int c = 0; c < PLACES; c++) {
    least = smaller(g->value[c], least);
    value[c] = larger(g->value[c], 0.0);
  }
  fill(power, exponent, PLACES);
  hamsym_pow(value, power, value, PLACES);
  double rounding = product(size * g->rounding / least, size_of(value)), exact = value[MIDDLE];
  truncate_values(t, value, rounding);
  model inverse;
  reciprocal(t, g, &inverse);
  slopes_of(t, g, slope);
  for (int c = 0; c < PLACES; c++) rate[c] = exponent * slope[c] * inverse.value[c];
  double lost = truncate_values(t, rate, 0.0) + product(size * inverse.error, BETWEEN * size_of(slope));
  for (int c = 0; c < PLACES; c++) slope[c] = rate[c] * value[c];
  double defect = defect_of(t, value, slope, rounding) + 2 * product(lost, BETWEEN * size_of(value));
  double start = fabs(exact - value[MIDDLE]) + SMALLEST, ends[2] = {g->low, g->high};
  scalar_power(ends, exponent);
  double low = smaller(ends[0], ends[1]), high = larger(ends[0], ends[1]);
  double ratio[2] = {g->high / g->low, 0.0};
  scalar_power(ratio, size);
  double error = ratio[0] * start + defect * (1.0 + 2.0 * BETWEEN * size_of(rate) * ratio[0]);
  error += product(high, value_at(hamsym_expm1, size * g->error / g->low));
  if (!(g->low > 0.0)) error = INFINITY;
  if (leaves(g, 0.0, INFINITY)) high = INFINITY;
  memcpy(out->value, value, sizeof value);
  tighten(out, error, rounding, low, high);
}

/* A product of squares, for an integer exponent that is not negative. */
static void integer_power(const model_tables *t, const model *g, long exponent, model *out) {
  model square = *g, found, next;
  make_constant(&found, 1.0);
  for (; exponent; exponent /= 2) {
    if (exponent % 2) {
      multiply(t, &square, &found, &next);
      found = next;
    }
    if (exponent > 1) {
      multiply(t, &square, &square, &next);
      square = next;
    }
  }
  *out = found;
}

static void power(const model_tables *t, const model *base, const model *exponent, model *out) {
  model found = *base, next;
  if (exponent->constant) {
    double n = exponent->low, size = fabs(n);
    /* Many products lose digits; but only they take bases that are not positive. */
    double most = base->low > 0.0 || n != floor(n) ? 64.0 : 0x1p20;
    if (!(size <= most) || 2 * n != floor(2 * n)) {
      number_power(t, base, n, out);
      return;
    }
    if (n < 0.0) {
      reciprocal(t, base, &next);
      found = next;
    }
    if (n != floor(n)) { /* a power of a root */
      root(t, &found, &next);
      found = next;
      size *= 2;
    }
    integer_power(t, &found, (long)size, out);
    return;
  }
  if (base->constant) scaled(exponent, value_at(hamsym_log, base->low), &found);
  else {
    inverse_function(t, LOG, base, &next);
    multiply(t, &next, exponent, &found);
  }
  exponential(t, &found, out);
}

/* atan2(y, x): the angle, with its jump where y = 0 and x < 0. */
static void angle(const model_tables *t, const model *y, const model *x, model *out) {
  double value[PLACES], first[PLACES], second[PLACES];
  model one, other, square, distance, inverse;
  hamsym_atan2(y->value, x->value, value, PLACES);
  int cut = !(x->low > 0.0 || y->low > 0.0 || y->high < 0.0);
  multiply(t, x, x, &one);
  multiply(t, y, y, &other);
  add(&one, &other, &square);
  reciprocal_root(t, &square, &distance);
  reciprocal(t, &square, &inverse);
  double rounding = product(x->rounding + y->rounding, size_of(distance.value)), exact = value[MIDDLE];
  truncate_values(t, value, rounding);
  slopes_of(t, y, first);
  slopes_of(t, x, second);
  for (int c = 0; c < PLACES; c++) {
    first[c] *= x->value[c];
    second[c] *= y->value[c];
  }
  double allowed = UNIT * (size_of(first) + size_of(second));
  for (int c = 0; c < PLACES; c++) first[c] -= second[c];
  double lost = truncate_values(t, first, allowed);
  double missed = product(inverse.error, BETWEEN * size_of(first));
  missed += product(larger(fabs(inverse.low), fabs(inverse.high)), lost);
  for (int c = 0; c < PLACES; c++) first[c] *= inverse.value[c];
  double error = fabs(exact - value[MIDDLE]) + defect_of(t, value, first, rounding) + 2 * missed;
  error += product(x->error + y->error, larger(fabs(distance.low), fabs(distance.high)));
  memcpy(out->value, value, sizeof value);
  tighten(out, cut ? INFINITY : error, rounding, -PI, PI);
}

/* -- functions with kinks and jumps ------------------------------------------------------------ */

static void magnitude(const model *g, model *out) {
  if (g->low >= 0.0) *out = *g;
  else if (g->high <= 0.0) negative(g, out);
  else make_range(out, 0.0, larger(fabs(g->low), fabs(g->high)));
}

/* sign(g); a zero at an end of the range is passed over. */
static void sign(const model *g, model *out) {
  int nothing = g->low == 0.0 && g->high == 0.0;
  make_range(out, nothing ? 0.0 : g->low >= 0.0 ? 1.0 : -1.0, nothing ? 0.0 : g->high <= 0.0 ? -1.0 : 1.0);
}

static void most(const model *a, const model *b, model *out) {
  if (a->low >= b->high) *out = *a;
  else if (b->low >= a->high) *out = *b;
  else make_range(out, larger(a->low, b->low), larger(a->high, b->high));
}

/* -- programs ---------------------------------------------------------------------------------- */

static void perform(const model_tables *t, enum operation operation, const model *a, const model *b, model *out) {
  model first, second;
  switch (operation) {
    case COPY: *out = *a; break;
    case NEGATIVE: negative(a, out); break;
    case ADD: add(a, b, out); break;
    case SUBTRACT:
      negative(b, &first);
      add(a, &first, out);
      break;
    case MULTIPLY: multiply(t, a, b, out); break;
    case RECIPROCAL: reciprocal(t, a, out); break;
    case ROOT: root(t, a, out); break;
    case MAGNITUDE: magnitude(a, out); break;
    case SIGN: sign(a, out); break;
    case LEAST:
      negative(a, &first);
      negative(b, &second);
      most(&first, &second, out);
      negative(out, out);
      break;
    case MOST: most(a, b, out); break;
    case SIN: circular(t, a, out, 0); break;
    case COS: circular(t, a, 0, out); break;
    case TAN: tangent(t, a, out); break;
    case EXP: exponential(t, a, out); break;
    case SINH: case COSH: case TANH: hyperbolic(t, operation, a, out); break;
    case POWER: power(t, a, b, out); break;
    case ATAN2: angle(t, a, b, out); break;
    case OPERATIONS: break;
    default: inverse_function(t, operation, a, out);
  }
}

/* Operations on numbers alone are exact where they are for rows. */
static void perform_on_numbers(enum operation operation, double a, double b, model *out) {
  double x[8], y[8];
  fill(x, a, 8);
  fill(y, b, 8);
  perform_rows(operation, x, y, x, 8);
  make_constant(out, x[0]);
}

/* Models of the results of a program in rows of models, of which those of the inputs are given. */
static const model *make_rows(const program *p, const model_tables *t, model *row, const double *parameters) {
  model *own = row + p->dim + 1;
  for (long k = 0; k < p->parameters; k++) make_constant(own++, parameters[k]);
  for (long k = 0; k < p->numbers; k++) make_constant(own++, p->number[k]);
  for (const step *s = p->step, *end = s + p->steps; s < end; s++) {
    const model *a = row + s->first, *b = row + s->second;
    if (a->constant && b->constant) perform_on_numbers(s->operation, a->low, b->low, row + s->out);
    else if (has_both(s, end)) circular(t, a, row + s->out, row + s[1].out), s++;
    else perform(t, s->operation, a, b, row + s->out);
  }
  return own;
}

/* The model of a polynomial, of which what it has beyond the degree is part of the distance. */
static void make_model(const model_tables *t, const double *value, double low, double high, double rounding, model *out) {
  memcpy(out->value, value, PLACES * sizeof(double));
  tighten(out, truncate_values(t, out->value, rounding), rounding, low, high);
}

static double extent(const double *value, double *largest) {
  double top = value[0], bottom = value[0];
  for (int c = 1; c < PLACES; c++) {
    top = larger(value[c], top);
    bottom = smaller(value[c], bottom);
  }
  if (largest) *largest = larger(fabs(top), fabs(bottom));
  return top - bottom;
}

/* Bound the residual of each component on one interval from values at the places, dim x PLACES, and times with
   their range, what its values at the places leave out of that, and the round-off of the formula. The inputs are the
   first rows of both programs. */
static void bound_residual(const program *velocity, const program *force, const model_tables *t, const double *z,
                           const double *rates, const double *times, double start, double end,
                           const double *parameters, model *row, double *bounds, double *hidden, double *rounding) {
  long dim = velocity->dim, half = dim / 2;
  double largest, late = extent(times, &largest);
  /* A trial solution may be evaluated at times that are rounded. */
  late = 8 * EPS * largest / late;
  for (long i = 0; i < dim; i++, z += PLACES) make_model(t, z, -INFINITY, INFINITY, late * extent(z, 0), row + i);
  make_model(t, times, lesser(start, end), greater(start, end), 0.0, row + dim);
  for (long i = 0; i < dim; i++, rates += PLACES) {
    if (i % half == 0) make_rows(i ? force : velocity, t, row, parameters);
    const program *p = i < half ? velocity : force;
    const model *found = row + dim + 1 + p->parameters + p->numbers + i % half;
    model rest, other;
    make_model(t, rates, -INFINITY, INFINITY, late * extent(rates, 0), &rest);
    negative(found, &other);
    add(&rest, &other, &rest);
    /* What is round-off of the formula itself is no residual. */
    double rounded = ROUNDED * rest.rounding;
    bounds[i] = larger(larger(fabs(rest.low), fabs(rest.high)) - rounded, 0.0);
    hidden[i] = larger(rest.error - rounded, 0.0);
    rounding[i] = found->rounding;
  }
}

static model *rows_of(const program *one, const program *other) {
  long rows = all_rows(one), more = all_rows(other);
  return malloc((rows > more ? rows : more) * sizeof(model));
}

/* Bound the residual of each component on parts of windows, what its values at the places leave out, and the round-off
   of the formula in it.

   z, rates: the trial solution and its derivative, parts x dim x PLACES; t: parts x PLACES; ends: the least and
   the largest time of each part; parameters: those of each part are `stride` numbers further. */
EXPORTED int64_t hamsym_residual_bounds(const program *velocity, const program *force, const model_tables *t,
                                        int64_t parts, const double *z, const double *rates, const double *times,
                                        const double *ends, const double *parameters, int64_t stride, double *bounds,
                                        double *hidden, double *rounding) {
  long dim = velocity->dim, size = dim * PLACES;
  model *row = rows_of(velocity, force);
  if (!row) return 0;
  for (long k = 0; k < parts; k++)
    bound_residual(velocity, force, t, z + k * size, rates + k * size, times + k * PLACES, ends[2 * k],
                   ends[2 * k + 1], parameters + k * stride, row, bounds + k * dim, hidden + k * dim, rounding + k * dim);
  free(row);
  return 1;
}

void lay_out_bounds(bounding *m, arena *arena, const equations *H, const bound_tables *t) {
  long dim = H->dim, size = dim * PLACES;
  take_machine(arena, &m->velocity, H->velocity, PLACES);
  take_machine(arena, &m->force, H->force, PLACES);
  m->disc = (disc *)take(arena, discs_size(H->velocity, H->force));
  double **of_places[] = {&m->z, &m->rates, &m->found};
  for (int k = 0; k < 3; k++) *of_places[k] = take(arena, size);
  m->times = take(arena, PLACES);
  m->readout = take(arena, dim * t->columns);
  m->series = take(arena, dim * t->around->terms);
  m->memory = take(arena, dim * DISCS);
  double **small[] = {&m->bounds, &m->hidden, &m->rounding, &m->limits};
  for (int k = 0; k < 4; k++) *small[k] = take(arena, dim);
  m->row = 0;
}

/* Whether a bound of the residual of a window as a whole is within its limit: that of its values at the places and of
   the formulas in discs, or else that of its models. */
int is_bounded(bounding *m, const equations *H, const bound_tables *t, double tolerance, double start, double end,
               const double *state, const double *coefficient, long count, const double *sizes,
               const double *parameters) {
  long dim = H->dim, terms = t->around->terms;
  double h = end - start, length = fabs(h);
  for (long k = 0; k < count; k++)
    for (long i = 0; i < dim; i++) m->readout[i * t->columns + k] = coefficient[k * dim + i];
  products(t->values, t->columns, PLACES, m->readout, dim, m->z);
  shift(m->z, state, dim, PLACES);
  products(t->rates, t->columns, PLACES, m->readout, dim, m->rates);
  for (long c = 0; c < dim * PLACES; c++) m->rates[c] /= h;
  stretch(t->places, h, start, PLACES, m->times);
  products(t->series, t->columns, terms, m->readout, dim, m->series);
  for (long i = 0; i < dim; i++) m->series[i * terms] += state[i];
  trial_discs(t->around, m->series, dim, start, h, m->memory, m->disc);
  run_discs(H->velocity, parameters, m->disc, m->bounds);
  run_discs(H->force, parameters, m->disc, m->bounds + H->velocity->results);
  set_parameters(&m->velocity, parameters, PLACES);
  set_parameters(&m->force, parameters, PLACES);
  evaluate(&m->velocity, &m->force, m->z, m->times, PLACES, m->found);
  int good = 1;
  for (long i = 0; i < dim; i++) {
    double *rates = m->rates + i * PLACES, *found = m->found + i * PLACES;
    m->limits[i] = tolerance * sizes[i] + ROUND_OFF * length * row_size(rates, PLACES);
    for (long c = 0; c < PLACES; c++) found[c] -= rates[c];
    double most = LEBESGUE * row_size(found, PLACES) + t->around->share * m->bounds[i];
    good = good && most * length <= MOST_SHARES * greater(m->limits[i], TINY) && m->limits[i] < INFINITY;
  }
  if (good) return 1;
  if (!m->row) m->row = rows_of(H->velocity, H->force);
  if (!m->row) return 0;
  bound_residual(H->velocity, H->force, t->models, m->z, m->rates, m->times, start, end, parameters, m->row, m->bounds,
                 m->hidden, m->rounding);
  for (long i = 0; i < dim; i++) {
    double limit = greater(m->limits[i], TINY), large = m->bounds[i] * length, hidden = m->hidden[i] * length;
    if (!(large <= MOST_SHARES * limit && hidden <= HIDDEN * limit && limit < INFINITY)) return 0;
  }
  return 1;
}

/* Windows, which need not follow each other. */
typedef struct {
  int64_t windows, readout, size_stride, parameter_stride;
  double tolerance;
  const double *start, *end, *state, *coefficient, *size, *parameters;
} pieces;

/* Which windows are bounded. */
EXPORTED int64_t hamsym_bounded(const equations *H, const bound_tables *t, const pieces *w, int8_t *bounded) {
  bounding m;
  arena arena = {0};
  lay_out_bounds(&m, &arena, H, t);
  if (!allocate(&arena)) return 0;
  lay_out_bounds(&m, &arena, H, t);
  for (long k = 0; k < w->windows; k++)
    bounded[k] = is_bounded(&m, H, t, w->tolerance, w->start[k], w->end[k], w->state + k * H->dim,
                            w->coefficient + k * w->readout * H->dim, w->readout, w->size + k * w->size_stride,
                            w->parameters + k * w->parameter_stride);
  free(m.row);
  free(arena.whole);
  return 1;
}

/* Models of the results of a program on intervals: values parts x results x PLACES; error, rounding and range
   parts x results x 4. The inputs are polynomials with ranges, parts x (dim + 1) x 2, the time last. */
EXPORTED int64_t hamsym_models(const program *p, const model_tables *t, int64_t parts, const double *inputs,
                               const double *ranges, const double *parameters, int64_t stride, double *values,
                               double *bounds) {
  model *row = malloc(all_rows(p) * sizeof(model));
  if (!row) return 0;
  for (long k = 0; k < parts; k++, parameters += stride) {
    for (long i = 0; i <= p->dim; i++) {
      long place = k * (p->dim + 1) + i;
      make_model(t, inputs + place * PLACES, ranges[2 * place], ranges[2 * place + 1], 0.0, row + i);
    }
    const model *found = make_rows(p, t, row, parameters);
    for (long r = 0; r < p->results; r++, found++) {
      memcpy(values + (k * p->results + r) * PLACES, found->value, sizeof found->value);
      double *out = bounds + 4 * (k * p->results + r);
      out[0] = found->error;
      out[1] = found->rounding;
      out[2] = found->low;
      out[3] = found->high;
    }
  }
  free(row);
  return 1;
}
