/* Bounds of formulas in the complex plane around a window.

   A function that is analytic in the ellipse around a window with foci at its ends, whose half axes add up to
   rho half lengths, and that is bounded there by M, differs from its polynomial through n Chebyshev points by at
   most 4 M rho^(1 - n)/(rho - 1) (Trefethen, Approximation Theory and Approximation Practice, 2013). So a bound M
   that holds in discs around the window shows that nothing hides between the places of a residual: in its logarithm
   M need not be sharp, and arithmetic of discs finds it in a small part of the time that models take. Discs have their
   centres on the real axis, where the formulas are real. A function that is not analytic in a disc, or of which
   this arithmetic does not see it, has an infinite radius. Roundings are not counted. */

#ifndef HAMSYM_DISCS_H
#define HAMSYM_DISCS_H

#include "program.h"

#define DISCS 8

/* Values of one row in each of the discs around a window. */
typedef struct { double middle[DISCS], radius[DISCS]; } disc;

/* Tables of the discs that cover the ellipse; see hamsym/bounds/discs.py. */
typedef struct {
  int64_t terms;
  double radius;          /* of the discs, in window lengths */
  double share;           /* of the bound M by which polynomials differ at most */
  const double *place;    /* centres, in [0, 1] at the window */
  const double *middle;   /* Chebyshev coefficients -> values at the centres, terms x DISCS */
  const double *extent;   /* their magnitudes -> distances from these in the discs */
} disc_tables;

long discs_size(const program *one, const program *other);
void trial_discs(const disc_tables *t, double *series, long dim, double start, double h, double *memory, disc *row);
void run_discs(const program *program, const double *parameters, disc *row, double *bounds);

#endif
