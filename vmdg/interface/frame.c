/* The frame that turns with an interface, at its points: rotation, spin, and what both add to the
   tangent (84)-(85). frame.py has the derivation. Compiled with DIM, 2 or 3. */

#include <math.h>
#include <string.h>

enum
{
  SPINS = DIM == 3 ? 3 : 1,
  SECTION = DIM * DIM
};

typedef double vector[DIM];
typedef double tensor[DIM][DIM];
typedef double spins[SPINS][SECTION];

/* What the derivatives of a point need: current normal n = R.N, the spin omega = W:dF, half of it,
   and in space P = I - N (x) N, U, V, (tr(U) I - U)^-1 and W~ = R^T.W, in the plane t0 and 1/|F.t0|. */
typedef struct
{
  vector N, n;
  tensor R;
  spins W, half;
#if DIM == 3
  tensor P, U, V, inverse_inertia;
  spins pulled;
#else
  vector t0, t;
  double compliance;
#endif
} turn;

static void apply(const tensor A, const vector x, vector y)
{
  for (int i = 0; i < DIM; ++i)
  {
    y[i] = 0;
    for (int j = 0; j < DIM; ++j)
      y[i] += A[i][j] * x[j];
  }
}

/* C = A.B, or A^T.B where `transposed`, of `rows` x `inner` and `inner` x `columns` numbers. */
static void multiply(int rows, int inner, int columns, const double* A, const double* B, double* C,
                     int transposed)
{
  memset(C, 0, rows * columns * sizeof(double));
  for (int i = 0; i < rows; ++i)
    for (int m = 0; m < inner; ++m)
    {
      double a = transposed ? A[m * rows + i] : A[i * inner + m];
#pragma omp simd
      for (int j = 0; j < columns; ++j)
        C[i * columns + j] += a * B[m * columns + j];
    }
}

/* X with X.omega = omega x x. */
static void cross_matrix(const vector x, double X[DIM][SPINS])
{
#if DIM == 3
  memset(X, 0, DIM * sizeof(*X));
  X[0][1] = x[2], X[1][2] = x[0], X[2][0] = x[1];
  X[0][2] = -x[1], X[1][0] = -x[2], X[2][1] = -x[0];
#else
  X[0][0] = -x[1], X[1][0] = x[0];
#endif
}

#if DIM == 3
static void cross(const vector a, const vector b, vector c)
{
  for (int i = 0; i < 3; ++i)
    c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

static double dot(const vector a, const vector b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void normalize(vector a)
{
  double size = sqrt(dot(a, a));
  for (int i = 0; i < 3; ++i)
    a[i] /= size;
}

/* By the vector products of its rows. */
static void invert(const vector A[], vector inverse[])
{
  tensor columns;
  for (int i = 0; i < 3; ++i)
    cross(A[(i + 1) % 3], A[(i + 2) % 3], columns[i]);
  double det = dot(A[0], columns[0]);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      inverse[i][j] = columns[j][i] / det;
}

/* R: of tangents a, b of the surface, turned by the polar angle of its stretch, and of N. */
static void rotate(const tensor F, turn* at)
{
  vector a, b, Fa, Fb, least = {0}, first, second;
  const double* N = at->N;
  int axis = fabs(N[1]) < fabs(N[0]);
  axis = fabs(N[2]) < fabs(N[axis]) ? 2 : axis;
  least[axis] = 1;
  cross(N, least, a);
  normalize(a);
  cross(N, a, b);
  apply(F, a, Fa);
  apply(F, b, Fb);
  cross(Fa, Fb, at->n);
  normalize(at->n);
  memcpy(first, Fa, sizeof(first));
  normalize(first);
  cross(at->n, first, second);
  // In this basis the surface part of M is [[m11, m12], [0, m22]]; the polar angle makes it symmetric.
  double m12 = dot(first, Fb), trace = dot(first, Fa) + dot(second, Fb), size = hypot(m12, trace);
  double c = trace / size, s = -m12 / size;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      at->R[i][j] = (c * first[i] + s * second[i]) * a[j] + (c * second[i] - s * first[i]) * b[j]
                    + at->n[i] * N[j];
}

static void spin(const tensor F, turn* at)
{
  tensor FP, inertia, UV, XV;
  double X[3][3], moment[3][SECTION] = {{0}};
  const double* N = at->N;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      at->P[i][j] = (i == j) - N[i] * N[j];
  multiply(3, 3, 3, F[0], at->P[0], FP[0], 0);
  multiply(3, 3, 3, at->R[0], FP[0], at->U[0], 1);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      at->U[i][j] += N[i] * N[j];
  invert(at->U, inertia);
  multiply(3, 3, 3, inertia[0], at->P[0], UV[0], 0);
  multiply(3, 3, 3, at->P[0], UV[0], at->V[0], 0);
  double trace = at->U[0][0] + at->U[1][1] + at->U[2][2];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      inertia[i][j] = (i == j) * trace - at->U[i][j];
  invert(inertia, at->inverse_inertia);
  // -eps:(R^T.dM) of A = R^T.dF, entries of A row by row.
  cross_matrix(N, X);
  multiply(3, 3, 3, X[0], at->V[0], XV[0], 0);
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i)
      for (int c = 0; c < 3; ++c)
        moment[k][3 * i + c] = XV[k][c] * N[i];
  for (int k = 0; k < 3; ++k)
    for (int c = 0; c < 3; ++c)
    {
      int i = (k + 1) % 3, j = (k + 2) % 3;
      moment[k][3 * i + c] -= at->P[j][c];
      moment[k][3 * j + c] += at->P[i][c];
    }
  multiply(3, 3, SECTION, at->inverse_inertia[0], moment[0], at->pulled[0], 0);
  for (int k = 0; k < 3; ++k)
    multiply(3, 3, 3, at->R[0], at->pulled[k], at->W[k], 0);
}

/* vector.dU' for entries of dF', see add_gradient. */
static void stretch(const turn* at, const vector v, double row[3][SECTION])
{
  vector Rv, Vv;
  double X[3][3], UX[3][3];
  apply(at->R, v, Rv);
  apply(at->V, v, Vv);
  cross_matrix(v, X);
  multiply(3, 3, 3, at->U[0], X[0], UX[0], 0);
  multiply(3, 3, SECTION, UX[0], at->W[0], row[0], 0);
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i)
      for (int c = 0; c < 3; ++c)
        row[k][3 * i + c] += Rv[i] * at->P[k][c] - at->N[k] * at->n[i] * Vv[c];
}

/* Adds c.dW/dF for a couple c: a sum of ten products of two linear functions of dF. */
static void add_gradient(const turn* at, const double couple[SPINS], double sum[SECTION][SECTION])
{
  double left[10][SECTION], right[10][SECTION], product[SECTION][SECTION];
  tensor held, X;
  vector w, Nw, across;
  apply(at->inverse_inertia, couple, w);
  cross(at->N, w, Nw);
  apply(at->V, Nw, across);
  multiply(1, 3, SECTION, couple, at->pulled[0], held[0], 0);
  for (int i = 0; i < 3; ++i)
  {
    for (int a = 0; a < 3; ++a)
      for (int c = 0; c < 3; ++c)
        left[i][3 * a + c] = -at->V[i][c] * at->n[a];
    vector axis = {i == 0, i == 1, i == 2};
    // Omega.x = e_i x x of every column of c.W~.
    cross_matrix(axis, X);
    tensor turned;
    multiply(3, 3, 3, X[0], held[0], turned[0], 1);
    multiply(3, 3, 3, at->R[0], turned[0], left[6 + i], 0);
  }
  memcpy(left[3], at->W, sizeof(spins));
  multiply(1, 3, SECTION, w, at->W[0], left[9], 0);
  for (int c = 0; c < SECTION; ++c)
    left[9][c] = -left[9][c];
  stretch(at, across, right);
  stretch(at, w, right + 3);
  memcpy(right[6], at->W, sizeof(spins));
  multiply(3, 3, 3, at->R[0], at->P[0], right[9], 0);
  multiply(SECTION, 10, SECTION, left[0], right[0], product[0], 1);
  for (int r = 0; r < SECTION; ++r)
    for (int c = 0; c < SECTION; ++c)
      sum[r][c] += product[r][c];
}
#else
static void rotate(const tensor F, turn* at)
{
  const double* N = at->N;
  at->t0[0] = -N[1], at->t0[1] = N[0];
  apply(F, at->t0, at->t);
  at->compliance = 1 / hypot(at->t[0], at->t[1]);
  at->t[0] *= at->compliance, at->t[1] *= at->compliance;
  at->n[0] = at->t[1], at->n[1] = -at->t[0];
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 2; ++j)
      at->R[i][j] = at->t[i] * at->t0[j] + at->n[i] * N[j];
}

static void spin(const tensor F, turn* at)
{
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 2; ++j)
      at->W[0][2 * i + j] = -at->n[i] * at->t0[j] * at->compliance;
}

static void add_gradient(const turn* at, const double couple[SPINS], double sum[SECTION][SECTION])
{
  double factor = couple[0] * at->compliance * at->compliance;
  for (int i = 0; i < SECTION; ++i)
    for (int j = 0; j < SECTION; ++j)
    {
      int a = i / 2, b = i % 2, c = j / 2, d = j % 2;
      double both = at->t[a] * at->n[c] + at->n[a] * at->t[c];
      sum[i][j] += factor * both * at->t0[b] * at->t0[d];
    }
}
#endif

static turn begin(const tensor F, const vector N)
{
  turn at;
  memcpy(at.N, N, sizeof(vector));
  rotate(F, &at);
  spin(F, &at);
  for (int k = 0; k < SPINS; ++k)
    for (int c = 0; c < SECTION; ++c)
      at.half[k][c] = at.W[k][c] / 2;
  return at;
}

/* R and W of `count` points from their mean deformation gradients and normals. */
void frames(long count, const tensor F[], const vector N[], tensor R[], spins W[])
{
  for (long p = 0; p < count; ++p)
  {
    turn at = begin(F[p], N[p]);
    memcpy(R[p], at.R, sizeof(tensor));
    memcpy(W[p], at.W, sizeof(spins));
  }
}

/* C = R.C~.R^T, and changes: Z of zeta with the gradient of either side, MT and MS of the couple M with
   the traction and with that gradient.

   C~, q, zeta~, T~: of the return map, in the frame of the law. */
void turning_tangents(long count, const tensor F[], const vector N[], const tensor compliance[],
                      const vector q[], const vector gap[], const vector traction[], tensor C[],
                      double Z[][DIM][SECTION], double MT[][SECTION][DIM],
                      double MS[][SECTION][SECTION])
{
  for (long p = 0; p < count; ++p)
  {
    turn at = begin(F[p], N[p]);
    double Tz[DIM][SPINS], Tq[DIM][SPINS], CTq[DIM][SPINS], rest[DIM][SPINS], couple[SPINS];
    double D[SPINS][DIM], RD[DIM][SPINS], DTq[SPINS][SPINS];
    double back[DIM][SPINS], turned[SPINS][SECTION];
    tensor RC;
    multiply(DIM, DIM, DIM, at.R[0], compliance[p][0], RC[0], 0);
    for (int i = 0; i < DIM; ++i)
      for (int j = 0; j < DIM; ++j)
      {
        C[p][i][j] = 0;
        for (int m = 0; m < DIM; ++m)
          C[p][i][j] += RC[i][m] * at.R[j][m];
      }
    cross_matrix(gap[p], Tz);
    cross_matrix(q[p], Tq);
    // Z = R.([zeta~] - C~.[q]).W / 2.
    multiply(DIM, DIM, SPINS, compliance[p][0], Tq[0], CTq[0], 0);
    for (int i = 0; i < DIM; ++i)
      for (int k = 0; k < SPINS; ++k)
        rest[i][k] = Tz[i][k] - CTq[i][k];
    multiply(DIM, DIM, SPINS, at.R[0], rest[0], back[0], 0);
    multiply(DIM, SPINS, SECTION, back[0], at.half[0], Z[p][0], 0);
    // D = [zeta~]^T - [q]^T.C~.
    multiply(SPINS, DIM, DIM, Tq[0], compliance[p][0], D[0], 1);
    for (int k = 0; k < SPINS; ++k)
      for (int i = 0; i < DIM; ++i)
        D[k][i] = Tz[i][k] - D[k][i];
    for (int i = 0; i < DIM; ++i)
      for (int k = 0; k < SPINS; ++k)
      {
        RD[i][k] = 0;
        for (int m = 0; m < DIM; ++m)
          RD[i][k] += at.R[i][m] * D[k][m];
      }
    for (int c = 0; c < SECTION; ++c)
      for (int i = 0; i < DIM; ++i)
      {
        MT[p][c][i] = 0;
        for (int k = 0; k < SPINS; ++k)
          MT[p][c][i] += at.half[k][c] * RD[i][k];
      }
    multiply(SPINS, DIM, SPINS, D[0], Tq[0], DTq[0], 0);
    multiply(SPINS, SPINS, SECTION, DTq[0], at.half[0], turned[0], 0);
    for (int k = 0; k < SPINS; ++k)
      for (int c = 0; c < SECTION; ++c)
        turned[k][c] = -turned[k][c];
    multiply(SECTION, SPINS, SECTION, at.half[0], turned[0], MS[p][0], 1);
    // zeta~ x T~, a quarter of it: M is half of c.W, and each side has half of F.
    multiply(1, DIM, SPINS, traction[p], Tz[0], couple, 0);
    int loaded = 0;
    for (int k = 0; k < SPINS; ++k)
    {
      loaded |= couple[k] != 0;
      couple[k] /= 4;
    }
    if (loaded)
      add_gradient(&at, couple, MS[p]);
  }
}
