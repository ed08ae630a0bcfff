/* Tangents of cells in space, the first term of (85): sums of B^T.A.B dV over the points of a cell.

   As a form it has a product of every test with every trial function for each of 81 moduli. Here A
   meets the trial functions first, which leaves 2.5 times fewer products, A and the matrix are
   symmetric but for non-associated flow, which spares a third of these, and the shape functions of a
   cell are done at a time.

   Compiled with NODES, of a displacement, MAP_NODES, of the geometry, POINTS, ENTRIES, of GRAD in A,
   those of the displacement are the first nine, and SYMMETRIC, 0 or 1. */

#include <string.h>

#include "vectors.h"

enum
{
  DIM = 3,
  SIZE = DIM * NODES,
  COMPONENTS = SYMMETRIC ? ENTRIES * (ENTRIES + 1) / 2 : ENTRIES * ENTRIES
};

/* Place of A_rc, r <= c, in the upper half of A, row by row, and of any A_rc in A. */
#define UPPER(r, c) ((r) * (2 * ENTRIES - (r) - 1) / 2 + (c))
#define PLACE(r, c) (!SYMMETRIC ? (r) * ENTRIES + (c) : (r) < (c) ? UPPER(r, c) : UPPER(c, r))

/* J^-T of the map from the reference cell at a point, and |det J|. */
static double invert(const double J[DIM][DIM], double inverse[DIM][DIM])
{
  double det = 0;
  for (int i = 0; i < DIM; ++i)
    for (int t = 0; t < DIM; ++t)
    {
      int j = (i + 1) % DIM, k = (i + 2) % DIM, u = (t + 1) % DIM, v = (t + 2) % DIM;
      inverse[i][t] = J[j][u] * J[k][v] - J[j][v] * J[k][u];
    }
  for (int t = 0; t < DIM; ++t)
    det += J[0][t] * inverse[0][t];
  for (int i = 0; i < DIM; ++i)
    for (int t = 0; t < DIM; ++t)
      inverse[i][t] /= det;
  return det < 0 ? -det : det;
}

/* GRAD of the shape functions at a point, and dV; x are the nodes of the cell. */
static double gradients(const double x[MAP_NODES][DIM], const double map_slopes[][POINTS][MAP_NODES],
                        shapes slopes[][POINTS], int q, double weight, shapes g[DIM])
{
  double J[DIM][DIM] = {{0}}, inverse[DIM][DIM];
  for (int i = 0; i < DIM; ++i)
    for (int t = 0; t < DIM; ++t)
      for (int n = 0; n < MAP_NODES; ++n)
        J[i][t] += x[n][i] * map_slopes[t][q][n];
  double volume = weight * invert(J, inverse);
  for (int j = 0; j < DIM; ++j)
    for (int c = 0; c < CHUNKS; ++c)
      g[j][c] = inverse[j][0] * slopes[0][q][c] + inverse[j][1] * slopes[1][q][c]
                + inverse[j][2] * slopes[2][q][c];
  return volume;
}

/* Adds what a point has of the components i of test and k of trial functions. */
static void add_block(int i, int k, const double A[COMPONENTS], shapes g[DIM], double dV,
                      shapes K[NODES])
{
  for (int j = 0; j < DIM; ++j)
  {
    double moduli[DIM];
    for (int l = 0; l < DIM; ++l)
      moduli[l] = dV * A[PLACE(DIM * i + j, DIM * k + l)];
    const double* test = (const double*)g[j];
    for (int c = 0; c < CHUNKS; ++c)
    {
      chunk stress = moduli[0] * g[0][c] + moduli[1] * g[1][c] + moduli[2] * g[2][c];
      for (int n = 0; n < NODES; ++n)
        K[n][c] += test[n] * stress;
    }
  }
}

/* A and nodes of `count` cells -> matrices of their dofs, component by component of every node. */
void cell_tangents(long count, const double A[][POINTS][COMPONENTS], const double x[][MAP_NODES][DIM],
                   const double slopes[DIM][POINTS][NODES],
                   const double map_slopes[DIM][POINTS][MAP_NODES], const double weights[POINTS],
                   double matrices[][SIZE][SIZE])
{
  shapes filled[DIM][POINTS] = {{{{0}}}};
  for (int t = 0; t < DIM; ++t)
    for (int q = 0; q < POINTS; ++q)
      memcpy(filled[t][q], slopes[t][q], sizeof(slopes[t][q]));
  for (long cell = 0; cell < count; ++cell)
  {
    shapes g[POINTS][DIM];
    double dV[POINTS];
    for (int q = 0; q < POINTS; ++q)
      dV[q] = gradients(x[cell], map_slopes, filled, q, weights[q], g[q]);
    for (int i = 0; i < DIM; ++i)
      for (int k = SYMMETRIC ? i : 0; k < DIM; ++k)
      {
        shapes K[NODES] = {{{0}}};
        for (int q = 0; q < POINTS; ++q)
          add_block(i, k, A[cell][q], g[q], dV[q], K);
        for (int n = 0; n < NODES; ++n)
          for (int m = 0; m < NODES; ++m)
          {
            double value = ((const double*)K[n])[m];
            matrices[cell][DIM * n + i][DIM * m + k] = value;
            if (SYMMETRIC)
              matrices[cell][DIM * m + k][DIM * n + i] = value;
          }
      }
  }
}
