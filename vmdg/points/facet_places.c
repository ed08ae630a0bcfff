/* Points on curved facets whose projections into a plane are given, by Newton's method. Compiled with
   DIM, POINTS on a facet, and DEGREE and TERMS of the polynomials that facets are. */

#include <math.h>

enum { PLANE = DIM - 1 };

/* Iterations, and the correction relative to the facet at which they end. */
enum { MOST = 20 };
static const double FOUND = 1e-13;

/* x, and its derivatives along the facet. */
static void evaluate(const double polynomial[TERMS][DIM], const long exponents[TERMS][PLANE],
                     const double eta[PLANE], double x[DIM], double slopes[PLANE][DIM])
{
  double powers[PLANE][DEGREE + 1];
  for (int k = 0; k < PLANE; ++k)
  {
    powers[k][0] = 1;
    for (int n = 1; n <= DEGREE; ++n)
      powers[k][n] = powers[k][n - 1] * eta[k];
  }
  for (int i = 0; i < DIM; ++i)
  {
    x[i] = 0;
    for (int k = 0; k < PLANE; ++k)
      slopes[k][i] = 0;
  }
  for (int m = 0; m < TERMS; ++m)
    /* The value for n = -1, else the derivative by eta_n. */
    for (int n = -1; n < PLANE; ++n)
    {
      double factor = 1, *sum = n < 0 ? x : slopes[n];
      for (int k = 0; k < PLANE; ++k)
      {
        long e = exponents[m][k];
        factor *= k != n ? powers[k][e] : e ? e * powers[k][e - 1] : 0;
      }
      for (int i = 0; i < DIM; ++i)
        sum[i] += factor * polynomial[m][i];
    }
}

static double dot(const double a[DIM], const double b[DIM])
{
  double sum = 0;
  for (int i = 0; i < DIM; ++i)
    sum += a[i] * b[i];
  return sum;
}

/* Solves A.x = b; returns |det A|. */
static double solve(const double A[PLANE][PLANE], const double b[PLANE], double x[PLANE])
{
#if DIM == 2
  x[0] = b[0] / A[0][0];
  return fabs(A[0][0]);
#else
  double det = A[0][0] * A[1][1] - A[0][1] * A[1][0];
  x[0] = (b[0] * A[1][1] - b[1] * A[0][1]) / det;
  x[1] = (b[1] * A[0][0] - b[0] * A[1][0]) / det;
  return fabs(det);
#endif
}

/* Normal of a facet with these tangents, as long as its area for a unit of eta. */
static void normal_of(const double tangents[PLANE][DIM], double normal[DIM])
{
#if DIM == 2
  normal[0] = tangents[0][1];
  normal[1] = -tangents[0][0];
#else
  const double *a = tangents[0], *b = tangents[1];
  for (int i = 0; i < 3; ++i)
    normal[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
#endif
}

/* Points of `count` segments on facets `rows`.

   reference, current: polynomials of facets, X and x; exponents: of their terms; signs: of outward
   normals; start: eta of the middle of a facet; axes, centres, plane: axes and origin of the plane of a
   segment, and the points there; found: eta, X, the unit normal, and area per area in the plane. */
void places(long count, const long rows[], const double reference[][TERMS][DIM],
            const double current[][TERMS][DIM], const long exponents[TERMS][PLANE],
            const double signs[], const double start[PLANE], const double axes[][PLANE][DIM],
            const double centres[][DIM], const double plane[][POINTS][PLANE],
            double etas[][POINTS][PLANE], double positions[][POINTS][DIM],
            double normals[][POINTS][DIM], double stretch[][POINTS])
{
  for (long s = 0; s < count; ++s)
    for (int q = 0; q < POINTS; ++q)
    {
      double *eta = etas[s][q], x[DIM], slopes[PLANE][DIM], area = 1;
      for (int k = 0; k < PLANE; ++k)
        eta[k] = start[k];
      for (int iteration = 0; iteration < MOST; ++iteration)
      {
        double A[PLANE][PLANE], away[PLANE], change[PLANE], largest = 0;
        evaluate(current[rows[s]], exponents, eta, x, slopes);
        for (int k = 0; k < PLANE; ++k)
        {
          away[k] = plane[s][q][k] - dot(axes[s][k], x) + dot(axes[s][k], centres[s]);
          for (int l = 0; l < PLANE; ++l)
            A[k][l] = dot(axes[s][k], slopes[l]);
        }
        area = solve(A, away, change);
        for (int k = 0; k < PLANE; ++k)
          largest = fmax(largest, fabs(change[k]));
        if (largest < FOUND)
          break;
        for (int k = 0; k < PLANE; ++k)
          eta[k] += change[k];
      }
      double *normal = normals[s][q];
      evaluate(reference[rows[s]], exponents, eta, positions[s][q], slopes);
      normal_of(slopes, normal);
      double size = sqrt(dot(normal, normal));
      stretch[s][q] = size / area;
      for (int i = 0; i < DIM; ++i)
        normal[i] *= signs[rows[s]] / size;
    }
}
