/* Steps of an enclosure of the true solution over one window of time: lemmas 16 to 20 of
   examples/guide/how_proofs_work.md.

   The equation is dz/dx = w G(t, z, k) on -1 <= x <= 1, with the half length w of the window, time t = t_m + w x and
   constants k (parameters that are not known exactly). y(x) is a polynomial near the solution, V(x) one near its
   derivatives by the start and by k; both are guesses, found by collocation at Chebyshev points without bounds. With
   the defects D of y and K of V, V(-1) = I + F, and an interval matrix A_0 + B around w DG over a tube,

       z = y + (V - K) xi - D + d,   d' = A d + (B V - A K) xi - A D,   d(-1) = -F xi. */

#ifndef HAMSYM_ENCLOSURES_H
#define HAMSYM_ENCLOSURES_H

#include "series.h"

/* An entry (i, j) of a matrix, in a row of numbers. */
typedef struct { int64_t i, j, place; } entry;

#endif
