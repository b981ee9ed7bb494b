#include "program.h"
#include "functions.h"
#include <math.h>
#include <stdlib.h>

long all_rows(const program *p) {
  return p->dim + 1 + p->parameters + p->numbers + p->results + p->intermediates;
}

/* Whether a program reads and writes rows of its own only, each after it was written. */
EXPORTED int64_t hamsym_check_program(const program *p) {
  const int64_t most = INT32_MAX / 8;
  const int64_t counts[] = {p->dim, p->parameters, p->numbers, p->results, p->intermediates, p->steps};
  for (int k = 0; k < 6; k++)
    if (counts[k] < 0 || counts[k] > most) return 0;
  const long rows = all_rows(p), first = rows - p->results - p->intermediates;
  if (rows > most) return 0;
  if (p->function) return 1;
  char *written = calloc(rows + 1, 1);
  if (!written) return 0;
  memset(written, 1, first);
  int good = 1;
  for (long s = 0; s < p->steps && good; s++) {
    const step *one = p->step + s;
    good = one->operation >= 0 && one->operation < OPERATIONS && one->out >= first && one->out < rows;
    good = good && one->first >= 0 && one->first < rows && one->second >= 0 && one->second < rows;
    good = good && written[one->first] && written[one->second];
    if (good) written[one->out] = 1;
  }
  for (long r = 0; r < p->results && good; r++) good = written[first + r];
  free(written);
  return good;
}

/* Doubles before the rows of a machine, for pointers to all rows, which take as much memory at most. */
static long before_rows(const program *p) { return (all_rows(p) + LINE) / LINE * LINE; }

/* Characters behind the rows of a machine: one for each row and each step. */
static long behind_rows(const program *p) { return all_rows(p) + p->steps; }

long machine_size(const program *p, long stride) {
  return before_rows(p) + (p->parameters + p->numbers + p->intermediates) * stride + behind_rows(p) / sizeof(double) + 1;
}

/* Note the roundings of all steps. */
static void note_roundings(machine *m, char *still) {
  const program *p = m->program;
  m->rounding = still + all_rows(p);
  memset(still, 0, all_rows(p));
  memset(still + p->dim + 1, 1, p->parameters + p->numbers);
  for (long k = 0; k < p->steps; k++) {
    const step *s = p->step + k;
    int exact = s->operation == COPY || s->operation == NEGATIVE || (s->operation >= MAGNITUDE && s->operation <= MOST);
    still[s->out] = still[s->first] && still[s->second];
    m->rounding[k] = exact ? EXACT : still[s->out] ? STEADY : CHANGING;
  }
}

void make_machine(machine *m, const program *p, double *memory, long stride) {
  m->program = p;
  m->row = (double **)memory;
  double *next = memory + before_rows(p);
  long row = p->dim + 1;
  for (long k = 0; k < p->parameters + p->numbers; k++, next += stride) m->row[row++] = next;
  row += p->results;
  for (long k = 0; k < p->intermediates; k++, next += stride) m->row[row++] = next;
  for (long k = 0; k < p->numbers; k++) fill(m->row[p->dim + 1 + p->parameters + k], p->number[k], stride);
  note_roundings(m, (char *)next);
}

void set_parameters(machine *m, const double *parameters, long stride) {
  m->parameters = parameters;
  for (long k = 0; k < m->program->parameters; k++) fill(m->row[m->program->dim + 1 + k], parameters[k], stride);
}

INLINE vw signs_of(vw x) {
  vw found = choose((iw)(x > 0.0), spread(1.0), choose((iw)(x < 0.0), spread(-1.0), spread(0.0)));
  return choose((iw)(x != x), x, found);
}

INLINE vw roots(vw x) {
  for (int k = 0; k < LANES; k++) x[k] = __builtin_sqrt(x[k]);
  return x;
}

/* Every operation is a loop of its own over a row. */
#define EACH(expression) \
  for (long c = 0; c < n; c += LANES) { \
    vw x = load(a + c), y = load(b + c); \
    (void)y; \
    store(out + c, expression); \
  } \
  break

INLINE void perform(enum operation operation, const double *a, const double *b, double *out, long n) {
  switch (operation) {
    case COPY: EACH(x);
    case NEGATIVE: EACH(-x);
    case ADD: EACH(x + y);
    case SUBTRACT: EACH(x - y);
    case MULTIPLY: EACH(x * y);
    case RECIPROCAL: EACH(1.0 / x);
    case ROOT: EACH(roots(x));
    case MAGNITUDE: EACH(magnitudes(x));
    case SIGN: EACH(signs_of(x));
    /* Of a number and NaN the result is NaN. */
    case LEAST: EACH(choose((iw)(x < y) | (iw)(x != x), x, y));
    case MOST: EACH(choose((iw)(x > y) | (iw)(x != x), x, y));
    case SIN: hamsym_sin(a, out, n); break;
    case COS: hamsym_cos(a, out, n); break;
    case TAN: hamsym_tan(a, out, n); break;
    case EXP: hamsym_exp(a, out, n); break;
    case LOG: hamsym_log(a, out, n); break;
    case ASIN: hamsym_asin(a, out, n); break;
    case ACOS: hamsym_acos(a, out, n); break;
    case ATAN: hamsym_atan(a, out, n); break;
    case SINH: hamsym_sinh(a, out, n); break;
    case COSH: hamsym_cosh(a, out, n); break;
    case TANH: hamsym_tanh(a, out, n); break;
    case ASINH: hamsym_asinh(a, out, n); break;
    case ACOSH: hamsym_acosh(a, out, n); break;
    case ATANH: hamsym_atanh(a, out, n); break;
    case ERF: hamsym_erf(a, out, n); break;
    case POWER: hamsym_pow(a, b, out, n); break;
    case ATAN2: hamsym_atan2(a, b, out, n); break;
    case OPERATIONS: break;
  }
}

void perform_rows(enum operation operation, const double *a, const double *b, double *out, long n) {
  perform(operation, a, b, out, n);
}

/* Put the rows of states, times and results in place. */
static double **entered(machine *m, const double *states, const double *times, long n, double *out) {
  const program *p = m->program;
  double **row = m->row;
  for (long i = 0; i < p->dim; i++) row[i] = (double *)states + i * n;
  row[p->dim] = (double *)times;
  double **result = row + p->dim + 1 + p->parameters + p->numbers;
  for (long r = 0; r < p->results; r++) result[r] = out + r * n;
  return row;
}

void run(machine *m, const double *states, const double *times, long n, double *out) {
  const program *p = m->program;
  if (p->function) {
    p->function(states, times, m->parameters, out, n);
    return;
  }
  double **row = entered(m, states, times, n, out);
  for (const step *s = p->step, *end = s + p->steps; s < end; s++)
    if (has_both(s, end)) {
      hamsym_sin_cos(row[s->first], row[s->out], row[s[1].out], n);
      s++;
    } else
      perform(s->operation, row[s->first], row[s->second], row[s->out], n);
}

int can_shift(const machine *m) {
  const program *p = m->program;
  for (long k = 0; k < p->numbers; k++)
    if (p->rest[k] != 0.0) return 1;
  return p->steps && memchr(m->rounding, STEADY, p->steps);
}

/* What rounding takes from the result of a step whose rows are the same number everywhere: `largest`, the most that it
   can be, where an operation has no exact remainder. */
static double remainder_of(enum operation operation, double x, double y, double found, double largest) {
  double rest = largest;
  if (operation == SUBTRACT) y = -y;
  if (operation == ADD || operation == SUBTRACT) {
    double added = found - x;
    rest = (x - (found - added)) + (y - added);
  } else if (operation == MULTIPLY) {
    rest = fma(x, y, -found);
  } else if (operation == RECIPROCAL) {
    rest = fma(-x, found, 1.0) * found;
  } else if (operation == ROOT && found > 0.0) {
    rest = fma(-found, found, x) / (2 * found);
  }
  return fabs(rest) <= fabs(largest) ? rest : largest;
}

/* Run with changed results of the steps with these roundings. */
static void run_changed(machine *m, const double *states, const double *times, long n, const double *signs,
                        double factor, enum rounding rounding, double *out) {
  const program *p = m->program;
  double **row = entered(m, states, times, n, out);
  for (long k = 0; k < p->steps; k++, signs += n) {
    const step *s = p->step + k;
    double *found = row[s->out];
    double x = *row[s->first], y = *row[s->second]; /* of which `found` may be one */
    perform(s->operation, row[s->first], row[s->second], found, n);
    if (m->rounding[k] != (char)rounding) continue;
    if (rounding == STEADY) {
      fill(found, *found + factor * remainder_of(s->operation, x, y, *found, EPS / 2 * *signs * *found), n);
      continue;
    }
    for (long c = 0; c < n; c += LANES)
      store(found + c, load(found + c) * (1.0 + factor * (EPS / 2) * load(signs + c)));
  }
}

void run_disturbed(machine *m, const double *states, const double *times, long n, const double *signs, double factor,
                   double *out) {
  if (m->program->function) run(m, states, times, n, out);
  else run_changed(m, states, times, n, signs, factor, CHANGING, out);
}

void run_shifted(machine *m, const double *states, const double *times, long n, const double *signs,
                 double factor, double *out) {
  const program *p = m->program;
  double **number = m->row + p->dim + 1 + p->parameters;
  for (long k = 0; k < p->numbers; k++) fill(number[k], p->number[k] + factor * p->rest[k], n);
  if (p->function) run(m, states, times, n, out);
  else run_changed(m, states, times, n, signs, factor, STEADY, out);
  for (long k = 0; k < p->numbers; k++) fill(number[k], p->number[k], n);
}
