/* Formulas as straight-line programs over rows.

   Row numbers of a program: the state's components, the time, the parameters, its numbers, its
   results, and rows of intermediate values. Each step writes a result or an intermediate value. */

#ifndef HAMSYM_PROGRAM_H
#define HAMSYM_PROGRAM_H

#include "rows.h"

enum operation {
  COPY, NEGATIVE, ADD, SUBTRACT, MULTIPLY, RECIPROCAL, ROOT, MAGNITUDE, SIGN, LEAST, MOST,
  SIN, COS, TAN, EXP, LOG, ASIN, ACOS, ATAN, SINH, COSH, TANH, ASINH, ACOSH, ATANH, ERF, POWER, ATAN2,
  OPERATIONS
};

typedef struct { int32_t operation, out, first, second; } step;

/* Values at rows that a caller computes: states (dim x n), times (n), parameters, out. */
typedef void rows_function(const double *states, const double *times, const double *parameters, double *out, int64_t n);

typedef struct {
  int64_t dim, parameters, numbers, results, intermediates, steps;
  const double *number, *rest; /* float64 numbers, and exact ones less these */
  const step *step;
  rows_function *function; /* in place of the steps, or null */
} program;

/* Roundings of a step: none, others at every place, or the same at all, since it depends on parameters and numbers alone. */
enum rounding { EXACT, CHANGING, STEADY };

/* A program with its rows in memory, each with room for `stride` numbers. */
typedef struct {
  const program *program;
  const double *parameters;
  double **row;
  char *rounding; /* of each step */
} machine;

/* Whether a step and the next one are the sine and the cosine of one row, which come together. */
INLINE int has_both(const step *s, const step *end) {
  return s->operation == SIN && s + 1 < end && s[1].operation == COS && s[1].first == s->first && s->out != s->first;
}

#define MAGNIFIED 256.0 /* times roundings, so that they are not rounded themselves */
#define SPREAD 0.41     /* of roundings, whose mean square is 1/6 of that of the largest one */

/* How many rows a program has. */
long all_rows(const program *program);
/* Doubles that a machine needs for rows of at most `stride` numbers. */
long machine_size(const program *program, long stride);
void make_machine(machine *machine, const program *program, double *memory, long stride);
void set_parameters(machine *machine, const double *parameters, long stride);
void run(machine *machine, const double *states, const double *times, long n, double *out);
/* The same where results of operations that may round change by `factor` times the largest rounding, with a row of n
   signs for each step. */
void run_disturbed(machine *machine, const double *states, const double *times, long n, const double *signs,
                   double factor, double *out);
/* The same where what is alike at all places changes, `factor` times: numbers, and results of operations on parameters
   and numbers alone, which run_disturbed leaves as they are, by what float64 lacks of them. Exact ones, as n - 1 in an
   exponent, stay: powers of negative numbers are real for whole exponents only. */
void run_shifted(machine *machine, const double *states, const double *times, long n, const double *signs,
                 double factor, double *out);
/* Whether that changes anything. */
int can_shift(const machine *machine);
void perform_rows(enum operation operation, const double *first, const double *second, double *out, long n);

#endif
