/* What the motion of pairs adds to the tangent of an interface, see partners.py for the terms and
   tangent.c for jets. Compiled with DIM, ENTRIES, of GRAD in a jet, and KNOWN, of them those of a
   displacement. */

#include <math.h>

enum
{
  JET = DIM + 2 * ENTRIES,
  SECTION = DIM * DIM,
  PLANE = DIM - 1,
  SPINS = DIM == 3 ? 3 : 1
};

/* Places of GRAD w_1 and GRAD w_2 in a jet. */
static const int START[2] = {DIM, DIM + ENTRIES};

typedef double vector[DIM];
typedef double tensor[DIM][DIM];
typedef double jets[DIM][JET];

/* The inverse of shift I + G. */
static void inverse(double shift, const double G[DIM][DIM], double result[DIM][DIM])
{
  double F[3][3] = {{0}}, cofactors[3][3], det = 0;
  F[2][2] = 1;
  for (int i = 0; i < DIM; ++i)
    for (int j = 0; j < DIM; ++j)
      F[i][j] = (i == j ? shift : 0) + G[i][j];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
    {
      int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, d = (j + 2) % 3;
      cofactors[i][j] = F[a][c] * F[b][d] - F[a][d] * F[b][c];
    }
  for (int j = 0; j < 3; ++j)
    det += F[0][j] * cofactors[0][j];
  for (int i = 0; i < DIM; ++i)
    for (int j = 0; j < DIM; ++j)
      result[i][j] = cofactors[j][i] / det;
}

/* Adds factor A.B. */
static void add_product(double factor, const double A[DIM][DIM], const double B[DIM][JET],
                        double sum[DIM][JET])
{
  for (int i = 0; i < DIM; ++i)
    for (int j = 0; j < DIM; ++j)
    {
      double a = factor * A[i][j];
#pragma omp simd
      for (int c = 0; c < JET; ++c)
        sum[i][c] += a * B[j][c];
    }
}

static double dot(const double a[DIM], const double b[DIM])
{
  double sum = 0;
  for (int i = 0; i < DIM; ++i)
    sum += a[i] * b[i];
  return sum;
}

/* y and the relative change of dA by jets; `ways` take a place into both bodies. */
static void shift(const double axes[PLANE][DIM], const double place[PLANE][PLANE],
                  const double place_slope[PLANE][PLANE][PLANE], const double growth[PLANE],
                  const double growth_slope[PLANE][PLANE], const double ways[2][DIM][DIM],
                  double y[DIM][JET], double grown[JET])
{
  for (int j = 0; j < DIM; ++j)
    for (int k = 0; k < PLANE; ++k)
    {
      grown[j] += growth[k] * axes[k][j];
      for (int i = 0; i < DIM; ++i)
        for (int l = 0; l < PLANE; ++l)
          y[i][j] += axes[l][i] * place[l][k] * axes[k][j];
    }
  for (int side = 0; side < 2; ++side)
    for (int j = 0; j < DIM; ++j)
      for (int l = 0; l < DIM; ++l)
      {
        int column = START[side] + DIM * j + l;
        for (int m = 0; m < PLANE; ++m)
        {
          double way = (side ? 1 : -1) * dot(axes[m], ways[side][l]);
          for (int k = 0; k < PLANE; ++k)
          {
            grown[column] += growth_slope[k][m] * axes[k][j] * way;
            for (int i = 0; i < DIM; ++i)
              for (int n = 0; n < PLANE; ++n)
                y[i][column] += axes[n][i] * place_slope[n][k][m] * axes[k][j] * way;
          }
        }
      }
}

/* The change of M_2 relative to it, by jets. */
static void stretch(const double v[DIM], const double m[DIM], const double inverses[2][DIM][DIM],
                    double ratio[JET])
{
  for (int side = 0; side < 2; ++side)
    for (int i = 0; i < DIM; ++i)
    {
      double part[DIM];
      for (int k = 0; k < DIM; ++k)
        part[k] = side ? m[i] * v[k] - (i == k) : (i == k) - v[i] * (2 * v[k] - m[k]);
      for (int j = 0; j < DIM; ++j)
        ratio[START[side] + DIM * i + j] = dot(part, inverses[side][j]);
    }
}

/* Adds the couple of the frame that no longer grows by the slip: T.R.(omega x R^T.g_T) by g. */
static void add_couple(const double n[DIM], const double R[DIM][DIM], const double W[SPINS][SECTION],
                       const double force[DIM], int row, double D[JET][JET])
{
  double local[3] = {0};
  for (int i = 0; i < DIM; ++i)
    for (int j = 0; j < DIM; ++j)
      local[i] += R[j][i] * force[j];
  for (int k = 0; k < DIM; ++k)
  {
    double along[3] = {0}, couple[3];
    for (int i = 0; i < DIM; ++i)
    {
      along[i] = R[k][i];
      for (int j = 0; j < DIM; ++j)
        along[i] -= R[j][i] * n[j] * n[k];
    }
    for (int s = 0; s < 3; ++s)
      couple[s] = along[(s + 1) % 3] * local[(s + 2) % 3] - along[(s + 2) % 3] * local[(s + 1) % 3];
    for (int s = 0; s < SPINS; ++s)
      for (int e = 0; e < SECTION; ++e)
        D[row + e][k] += couple[DIM == 3 ? s : 2] * W[s][e];
  }
}

/* Adds to D dA of `count` points.

   area: dA; G: GRAD u of both sides; N: of the law; N1, M: N_1 and -M_2; leads: shares of the sides in
   the frame; R, W: the frame; axes: of the plane, with
   place, place_slope, growth, growth_slope of :class:`.Shifts`; free: 0 for points of a bond; r: penalty;
   C: d zeta/dT; delta: weights; slopes1, slopes2: of P.N; T: traction; q: terms of (27); flux: P_2.M_2
   by the normal outward; Tt: Tt dA. C and slopes are null where they are zero. */
void add_partners(long count, const double area[], const double G[][2][DIM][DIM], const vector N[],
                  const vector N1[], const vector M[], const double leads[][2], const tensor R[], const double W[][SPINS][SECTION],
                  const double axes[][PLANE][DIM], const double place[][PLANE][PLANE],
                  const double place_slope[][PLANE][PLANE][PLANE], const double growth[][PLANE],
                  const double growth_slope[][PLANE][PLANE], const double free[], const double r[],
                  const tensor C[], const tensor delta[][2], const tensor slopes1[],
                  const tensor slopes2[], const vector T[], const double q[][JET],
                  const vector flux[], const jets Tt[], double D[][JET][JET])
{
  for (long p = 0; p < count; ++p)
  {
    const tensor* slopes[2] = {slopes1, slopes2};
    double n[DIM], v[DIM], m[DIM], other[DIM], inverses[2][DIM][DIM], ways[2][DIM][DIM];
    for (int a = 0; a < 2; ++a)
      inverse(1, G[p][a], inverses[a]);
    for (int i = 0; i < DIM; ++i)
    {
      n[i] = dot(R[p][i], N[p]);
      v[i] = m[i] = 0;
      for (int j = 0; j < DIM; ++j)
      {
        v[i] += inverses[0][j][i] * N1[p][j];
        m[i] += inverses[1][j][i] * M[p][j];
      }
    }
    double length = sqrt(dot(v, v)), size = dot(m, v) / length;
    for (int i = 0; i < DIM; ++i)
    {
      v[i] /= length;
      m[i] /= size;
    }
    for (int i = 0; i < DIM; ++i)
      other[i] = dot(inverses[1][i], v);
    double slope = dot(n, v);
    for (int i = 0; i < DIM; ++i)
      for (int j = 0; j < DIM; ++j)
      {
        ways[0][i][j] = inverses[0][i][j];
        ways[1][i][j] = inverses[1][i][j] - other[i] * m[j];
      }

    jets y = {{0}}, h, back, E, moved[2] = {{{0}}}, change = {{0}}, gap;
    double grown[JET] = {0}, ratio[JET] = {0};
    shift(axes[p], place[p], place_slope[p], growth[p], growth_slope[p], ways, y, grown);
    for (int i = 0; i < DIM; ++i)
      for (int c = 0; c < JET; ++c)
        h[i][c] = (i == c ? free[p] : 0) - y[i][c];
    for (int c = 0; c < JET; ++c)
    {
      double nearer = 0, away = 0;
      for (int i = 0; i < DIM; ++i)
      {
        nearer += m[i] * h[i][c];
        away += n[i] * h[i][c] + (n[i] - slope * v[i]) * y[i][c];
      }
      for (int i = 0; i < DIM; ++i)
      {
        E[i][c] = n[i] * (slope * nearer - away);
        back[i][c] = v[i] * nearer - h[i][c];
      }
    }
    add_product(1, inverses[0], y, moved[0]);
    add_product(1, inverses[1], back, moved[1]);
    if (free[p] != 0)
      stretch(v, m, inverses, ratio);

    /* {P.N} changes, and with it and the opening E the traction. */
    for (int a = 0; a < 2; ++a)
      if (slopes[a])
      {
        jets traction = {{0}};
        add_product(a ? -1 : 1, slopes[a][p], moved[a], traction);
        add_product(1, delta[p][a], traction, change);
      }
    for (int i = 0; i < DIM; ++i)
    {
      double mean = dot(delta[p][1][i], flux[p]);
      for (int c = 0; c < JET; ++c)
      {
        change[i][c] -= mean * ratio[c];
        D[p][i][c] += area[p] * change[i][c];
        gap[i][c] = r[p] * E[i][c] + change[i][c];
      }
    }
    if (C)
      add_product(-1, C[p], gap, E);
    for (int row = 0; row < JET; ++row)
      for (int c = 0; c < JET; ++c)
      {
        double sum = area[p] * q[p][row] * (grown[c] + (row < START[1] ? 0 : ratio[c]));
        for (int i = 0; i < DIM; ++i)
          sum += Tt[p][i][row] * E[i][c];
        D[p][row][c] += sum;
      }
    double force[DIM];
    for (int i = 0; i < DIM; ++i)
    {
      force[i] = area[p] * free[p] * T[p][i];
      for (int a = 0; a < 2; ++a)
        for (int k = 0; k < DIM; ++k)
          for (int c = 0; c < JET; ++c)
            D[p][START[a] + DIM * i + k][c] -= (a ? -1 : 1) * area[p] * T[p][i] * moved[a][k][c];
    }
    add_couple(n, R[p], W[p], force, START[leads[p][1] > leads[p][0]], D[p]);
  }
}

/* A derivative of a position or displacement at a point, from those of all kinds at all points. */
static const double* derivative(const double derivatives[], long kind, long count, long p)
{
  return derivatives + (kind * count + p) * DIM;
}

/* How P.N of one side changes with X along its facet, at `count` points.

   H: (A.N); X, u: their derivatives in the reference cell, kind by kind, first the values; first,
   second: the kinds of first and of second derivatives; G: entries of GRAD u; ways: directions in the
   reference facet. */
void traction_slopes(long count, const double H[][DIM][ENTRIES], const double X[], const double u[],
                     const long first[DIM], const long second[DIM][DIM], const double G[][KNOWN],
                     const double ways[][PLANE][DIM], double found[][DIM][DIM])
{
  for (long p = 0; p < count; ++p)
  {
    /* In the plane the second tangent is out of it. */
    double J[DIM][DIM], J_inverse[DIM][DIM], rates[PLANE][DIM] = {{0}}, t[2][3] = {{0}, {0, 0, 1}};
    for (int s = 0; s < DIM; ++s)
      for (int i = 0; i < DIM; ++i)
        J[i][s] = derivative(X, first[s], count, p)[i];
    inverse(0, J, J_inverse);
    for (int k = 0; k < PLANE; ++k)
    {
      /* d(GRAD u) = (d(du/dxi) - GRAD u.dJ).J^-1 along a direction. */
      double change[KNOWN] = {0};
      for (int i = 0; i < DIM; ++i)
        t[k][i] = dot(J[i], ways[p][k]);
      for (int s = 0; s < DIM; ++s)
      {
        double dJ[DIM] = {0}, bent[DIM] = {0};
        for (int r = 0; r < DIM; ++r)
          for (int i = 0; i < DIM; ++i)
          {
            dJ[i] += ways[p][k][r] * derivative(X, second[r][s], count, p)[i];
            bent[i] += ways[p][k][r] * derivative(u, second[r][s], count, p)[i];
          }
        for (int i = 0; i < DIM; ++i)
          for (int j = 0; j < DIM; ++j)
            change[DIM * i + j] += (bent[i] - dot(&G[p][DIM * i], dJ)) * J_inverse[s][j];
      }
      double radius = derivative(X, 0, count, p)[0];
      if (KNOWN > SECTION && radius > 0)
        change[KNOWN - 1] = (dot(G[p], t[k]) - G[p][KNOWN - 1] * t[k][0]) / radius;
      for (int i = 0; i < DIM; ++i)
        for (int e = 0; e < KNOWN; ++e)
          rates[k][i] += H[p][i][e] * change[e];
    }
    double metric[2][2] = {{0}}, dual[2][3];
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 2; ++k)
        for (int l = 0; l < 2; ++l)
          metric[k][l] += t[k][i] * t[l][i];
    double det = metric[0][0] * metric[1][1] - metric[0][1] * metric[1][0];
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 2; ++k)
        dual[k][i] = (metric[1 - k][1 - k] * t[k][i] - metric[0][1] * t[1 - k][i]) / det;
    for (int i = 0; i < DIM; ++i)
      for (int j = 0; j < DIM; ++j)
      {
        found[p][i][j] = 0;
        for (int k = 0; k < PLANE; ++k)
          found[p][i][j] += rates[k][i] * dual[k][j];
      }
  }
}
