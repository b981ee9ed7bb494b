/* Steps of an enclosure of the true solution over one window of time.

   The equation is dz/dx = w G(t, z, k) on -1 <= x <= 1, with the half length w of the window, time t = t_m + w x and
   constants k (parameters that are not known exactly). y(x) is a polynomial near the solution, V(x) one near its
   derivatives by the start and by k; both are guesses, found by collocation at Chebyshev points without bounds. What
   follows is proven for any y and V.

   Lemma (window). Let z(-1) = y(-1) + xi and k = k_0 + kappa, and write xi for both together. Let

       D(x) = y(x) - y(-1) - w int_-1^x G(t, y, k_0)         (the defect of y),
       A(x) = A_0(x) + B(x), an interval matrix that contains w DG(t, y + e, k_0 + kappa) for all |e_i| <= rho_i,
              A_0 polynomial,
       K(x) = V(x) - V(-1) - int_-1^x A_0 V                  (the defect of V), V(-1) = I + F.

   Then z = y + (V - K) xi - D + d as long as |z_i - y_i| < rho_i, where

       d' = A d + (B V - A K) xi - A D,   d(-1) = -F xi.

   Proof. e = z - y satisfies e = xi - D + int A e, because G(y + e) - G(y) is the mean of DG(y + s e) over
   0 <= s <= 1, times e. Put e = (V - K) xi - D + d and use (V - K) xi = xi + F xi + int A_0 V xi.

   Bound on d. With units U = diag(u) and m >= the largest eigenvalue of the symmetric part of U^-1 A U, m >= 0
   (bounded by Gershgorin's circles),

       |U^-1 d| <= e^(2m) (|U^-1 F xi| + 2 |U^-1 (|B V - A K| |xi| + |A| |D|)|)   (Dahlquist 1959).

   Existence. If |(V xi)_i| + sum_j |K_ij| |xi_j| + |D_i| + |d_i| < rho_i for every i, the solution exists on the whole
   window and stays inside the tube: at the first time at which it left it, or up to which it existed, the bound with
   "<" would hold (continuation of solutions).

   The derivative of the flow is dz(x)/d(z(-1), k) = V(x) - K(x) + V_d(x), with column c of V_d bounded like d with
   xi = e_c and without D, because it satisfies the linear equation with such an A. */

#ifndef HAMSYM_ENCLOSURES_H
#define HAMSYM_ENCLOSURES_H

#include "series.h"

/* An entry (i, j) of a matrix, in a row of numbers. */
typedef struct { int64_t i, j, place; } entry;

#endif
