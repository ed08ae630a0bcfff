/* The tangent of an interface in products of small matrices: D of (84)-(85) at its points, and the
   matrices B^T.D.B of its facets.

   A jet is the opening w_2 - w_1 and the entries of GRAD w_1 and GRAD w_2. The first DIM DIM entries
   of GRAD are those of the section, row by row; the next one, if nodes have DIM + 1 slopes, is w_1/r
   of an axisymmetric body. Compiled with DIM, ENTRIES, of GRAD in a jet, NODES, of a cell, SLOPES, of
   a shape function, and POINTS, of a facet. */

#include <string.h>

#include "vectors.h"

enum
{
  JET = DIM + 2 * ENTRIES,
  SECTION = DIM * DIM,
  SIZE = 2 * NODES * DIM,
  COMPONENTS = ENTRIES * (ENTRIES + 1) / 2
};

/* Adds factor A^T.B of rows of jets. */
static void add_product(int rows, const double A[][JET], const double B[][JET], double factor,
                        double D[JET][JET])
{
  for (int r = 0; r < JET; ++r)
    for (int m = 0; m < rows; ++m)
    {
      double a = factor * A[m][r];
#pragma omp simd
      for (int c = 0; c < JET; ++c)
        D[r][c] += a * B[m][c];
    }
}

/* A.B of DIM rows of jets. */
static void apply(int rows, const double A[][DIM], const double B[DIM][JET], double AB[][JET])
{
  for (int m = 0; m < rows; ++m)
#pragma omp simd
    for (int c = 0; c < JET; ++c)
    {
      double sum = 0;
      for (int l = 0; l < DIM; ++l)
        sum += A[m][l] * B[l][c];
      AB[m][c] = sum;
    }
}

/* Adds what depends on S, the sum of `leads` GRAD w of the section, to rows of jets. */
static void add_section(int rows, const double A[][SECTION], const double leads[2], double B[][JET])
{
  for (int side = 0; side < 2; ++side)
    for (int m = 0; m < rows; ++m)
      for (int c = 0; c < SECTION; ++c)
        B[m][DIM + side * ENTRIES + c] += leads[side] * A[m][c];
}

/* D dA and Tt dA of `count` points.

   delta, tau: weights of both sides, and tau_s; H: (A.N) of both sides, each with its own normal;
   K: independent components of both sides; C: d zeta/dT; Z, MT, MS: changes of zeta with S and of the
   couple M with T and S; leads: shares of both sides in S; delta_s: of the traction jump. Null where the
   interface has none. */
void point_tangents(long count, const double area[], const double delta[][2][DIM][DIM],
                    const double tau[][DIM][DIM], const double H1[][DIM][ENTRIES],
                    const double H2[][DIM][ENTRIES], const double K1[][COMPONENTS],
                    const double K2[][COMPONENTS], const double C[][DIM][DIM],
                    const double Z[][DIM][SECTION], const double MT[][SECTION][DIM],
                    const double MS[][SECTION][SECTION], const double leads[][2],
                    const double delta_s[][DIM][DIM], double D[][JET][JET], double T[][DIM][JET])
{
  memset(D, 0, count * sizeof(*D));
  for (long p = 0; p < count; ++p)
  {
    double flux[DIM][JET] = {{0}}, jump[DIM][JET] = {{0}};
    for (int m = 0; m < DIM; ++m)
      for (int e = 0; e < ENTRIES; ++e)
      {
        int first = DIM + e, second = DIM + ENTRIES + e;
        for (int l = 0; l < DIM; ++l)
        {
          flux[m][first] += delta[p][0][m][l] * H1[p][l][e];
          flux[m][second] -= delta[p][1][m][l] * H2[p][l][e];
        }
        jump[m][first] = H1[p][m][e];
        jump[m][second] = H2[p][m][e];
      }
    memcpy(T[p], flux, sizeof(flux));
    for (int m = 0; m < DIM; ++m)
      for (int l = 0; l < DIM; ++l)
        T[p][m][l] = tau[p][m][l];

    for (int r = 0; r < JET; ++r)
      for (int m = 0; m < DIM; ++m)
      {
        D[p][r][m] += flux[m][r];
        D[p][m][r] += T[p][m][r];
      }
    for (int side = 0; K1 && side < 2; ++side)
    {
      const double* K = side ? K2[p] : K1[p];
      int start = DIM + side * ENTRIES;
      for (int r = 0; r < ENTRIES; ++r)
        for (int c = r; c < ENTRIES; ++c, ++K)
        {
          D[p][start + r][start + c] += *K;
          if (c > r)
            D[p][start + c][start + r] += *K;
        }
    }
    if (C)
    {
      double change[DIM][JET];
      apply(DIM, C[p], T[p], change);
      if (Z)
      {
        double couple[SECTION][JET];
        apply(SECTION, MT[p], T[p], couple);
        add_section(DIM, Z[p], leads[p], change);
        add_section(SECTION, MS[p], leads[p], couple);
        for (int side = 0; side < 2; ++side)
          for (int r = 0; r < SECTION; ++r)
            for (int c = 0; c < JET; ++c)
              D[p][DIM + side * ENTRIES + r][c] -= leads[p][side] * couple[r][c];
      }
      add_product(DIM, T[p], change, -1, D[p]);
    }
    if (delta_s)
    {
      double fine[DIM][JET];
      apply(DIM, delta_s[p], jump, fine);
      add_product(DIM, jump, fine, -1, D[p]);
    }
    for (int r = 0; r < JET; ++r)
      for (int c = 0; c < JET; ++c)
        D[p][r][c] *= area[p];
    for (int m = 0; m < DIM; ++m)
      for (int c = 0; c < JET; ++c)
        T[p][m][c] *= area[p];
  }
}

/* Place in a jet of what component i of a side has in it: m = 0 the opening, then slopes of w_i. */
static int place(int side, int i, int m)
{
  return m == 0 ? i : DIM + side * ENTRIES + (m > DIM ? SECTION : DIM * i + m - 1);
}

/* Whether component i has it: only w_1 has a hoop entry. */
static int has(int i, int m) { return i == 0 || m <= DIM; }

/* Sum over the points of a facet for components i, k and sides a, b of test and trial functions. */
static void add_block(int i, int k, int a, int b, const double D[][JET][JET], const int points[POINTS],
                      shapes g[POINTS][2][1 + SLOPES], shapes block[NODES])
{
  for (int q = 0; q < POINTS; ++q)
    for (int m = 0; m <= SLOPES && has(i, m); ++m)
    {
      const double *row = D[points[q]][place(a, i, m)], *test = (const double*)g[q][a][m];
      double moduli[1 + SLOPES];
      for (int l = 0; l <= SLOPES; ++l)
        moduli[l] = has(k, l) ? row[place(b, k, l)] : 0;
      for (int c = 0; c < CHUNKS; ++c)
      {
        chunk flux = moduli[0] * g[q][b][0][c];
        for (int l = 1; l <= SLOPES; ++l)
          flux += moduli[l] * g[q][b][l][c];
        for (int n = 0; n < NODES; ++n)
          block[n][c] += test[n] * flux;
      }
    }
}

/* Shape functions and their slopes on both sides of `count` facets -> B^T.D.B of their dofs, component
   by component of every node. */
void facet_tangents(long count, const int points[][POINTS], const double values[][POINTS][2][NODES],
                    const double slopes[][POINTS][2][NODES][SLOPES], const double D[][JET][JET],
                    double matrices[][SIZE][SIZE])
{
  for (long f = 0; f < count; ++f)
  {
    shapes g[POINTS][2][1 + SLOPES] = {{{{{0}}}}};
    for (int q = 0; q < POINTS; ++q)
      for (int a = 0; a < 2; ++a)
        for (int n = 0; n < NODES; ++n)
        {
          ((double*)g[q][a][0])[n] = a ? values[f][q][a][n] : -values[f][q][a][n];
          for (int j = 0; j < SLOPES; ++j)
            ((double*)g[q][a][1 + j])[n] = slopes[f][q][a][n][j];
        }
    for (int i = 0; i < DIM; ++i)
      for (int k = 0; k < DIM; ++k)
        for (int a = 0; a < 2; ++a)
          for (int b = 0; b < 2; ++b)
          {
            shapes block[NODES] = {{{0}}};
            add_block(i, k, a, b, D, points[f], g, block);
            for (int n = 0; n < NODES; ++n)
              for (int m = 0; m < NODES; ++m)
                matrices[f][(a * NODES + n) * DIM + i][(b * NODES + m) * DIM + k]
                    = ((const double*)block[n])[m];
          }
  }
}

/* Add the forces B^T.q of all facets on the nodes of their cells to a vector. */
void add_forces(long facets, const int *points, const double *values, const double *gradients,
                const double *flux, const int *nodes, double *vector)
{
    const long jet = DIM + 2 * ENTRIES;
    for (long f = 0; f < facets; f++) {
        double forces[2 * NODES * DIM] = {0};
        for (int p = 0; p < POINTS; p++) {
            const double *q = flux + points[f * POINTS + p] * jet;
            for (int side = 0; side < 2; side++) {
                const long first = ((f * POINTS + p) * 2 + side) * NODES;
                const double *G = q + DIM + side * ENTRIES, sign = side ? 1.0 : -1.0;
                for (int n = 0; n < NODES; n++) {
                    const double *slope = gradients + (first + n) * SLOPES;
                    double *F = forces + (side * NODES + n) * DIM;
                    for (int i = 0; i < DIM; i++) {
                        double sum = sign * values[first + n] * q[i];
                        for (int j = 0; j < DIM; j++)
                            sum += G[i * DIM + j] * slope[j];
                        F[i] += sum;
                    }
                    if (SLOPES > DIM)
                        F[0] += G[DIM * DIM] * slope[SLOPES - 1];
                }
            }
        }
        for (int n = 0; n < 2 * NODES; n++)
            for (int i = 0; i < DIM; i++)
                vector[(long)nodes[f * 2 * NODES + n] * DIM + i] += forces[n * DIM + i];
    }
}
