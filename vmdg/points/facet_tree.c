/* Facets in a tree of boxes: what is along a line, and what is nearest. Compiled with DIM, and
   CORNERS of a facet. Node k of the tree has the children 2k + 1 and 2k + 2; its last half are the
   facets in `order`, -1 for none. */

#include <math.h>

typedef double vector[DIM];
typedef double facet[CORNERS][DIM];

/* Room for nodes to be visited, more than twice the levels of any tree. */
enum { DEPTH = 128 };

/* Sine of the angle below which a line is parallel to a facet, and how far beyond the sides of a
   facet, relative to it, a line still meets it, so that none slips between two. */
static const double PARALLEL = 1e-9, BESIDE = 1e-9;

static double dot(const vector a, const vector b)
{
  double sum = 0;
  for (int i = 0; i < DIM; ++i)
    sum += a[i] * b[i];
  return sum;
}

static void minus(const vector a, const vector b, vector c)
{
  for (int i = 0; i < DIM; ++i)
    c[i] = a[i] - b[i];
}

#if DIM == 3
static void cross(const vector a, const vector b, vector c)
{
  for (int i = 0; i < 3; ++i)
    c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}
#endif

/* Whether x + t way meets a facet; then t. */
static int meets(const facet f, const vector x, const vector way, double* t)
{
#if DIM == 2
  vector edge, from;
  minus(f[1], f[0], edge);
  minus(f[0], x, from);
  double det = way[0] * edge[1] - way[1] * edge[0];
  if (fabs(det) <= PARALLEL * sqrt(dot(way, way) * dot(edge, edge)))
    return 0;
  double u = (from[0] * way[1] - from[1] * way[0]) / det;
  *t = (from[0] * edge[1] - from[1] * edge[0]) / det;
  return u >= -BESIDE && u <= 1 + BESIDE;
#else
  for (int k = 1; k + 1 < CORNERS; ++k)
  {
    vector one, two, from, p, q;
    minus(f[k], f[0], one);
    minus(f[k + 1], f[0], two);
    minus(x, f[0], from);
    cross(way, two, p);
    cross(one, two, q);
    double det = dot(one, p);
    if (fabs(det) <= PARALLEL * sqrt(dot(way, way) * dot(q, q)))
      continue;
    cross(from, one, q);
    double u = dot(from, p) / det, v = dot(way, q) / det;
    *t = dot(two, q) / det;
    if (u >= -BESIDE && v >= -BESIDE && u + v <= 1 + BESIDE)
      return 1;
  }
  return 0;
#endif
}

/* Whether x + t way, low < t < high, meets a box; first, without a division, whether its own box does. */
static int enters(const vector bottom, const vector top, const vector x, const vector way, double low,
                  double high)
{
  for (int i = 0; i < DIM; ++i)
  {
    double a = x[i] + low * way[i], b = x[i] + high * way[i];
    if ((a < bottom[i] && b < bottom[i]) || (a > top[i] && b > top[i]) || !(bottom[i] <= top[i]))
      return 0;
  }
  for (int i = 0; i < DIM; ++i)
  {
    if (way[i] == 0)
    {
      if (x[i] < bottom[i] || x[i] > top[i])
        return 0;
      continue;
    }
    double a = (bottom[i] - x[i]) / way[i], b = (top[i] - x[i]) / way[i];
    double first = a < b ? a : b, last = a < b ? b : a;
    low = first > low ? first : low;
    high = last < high ? last : high;
    if (low > high)
      return 0;
  }
  return 1;
}

/* The first facets along lines x + t way, from t = start to t = end, but those to `skip`: t, and the
   facet, -1 for none. */
void first_along(long count, const vector x[], const vector way[], const double start[],
                 const double end[], const long skip[], const long leaves[1], const vector bottom[], const vector top[],
                 const long order[], const facet facets[], double found[], long which[])
{
  for (long n = 0; n < count; ++n)
  {
    long stack[DEPTH] = {0};
    int size = 1;
    found[n] = end[n];
    which[n] = -1;
    while (size)
    {
      long k = stack[--size], leaf = k - (leaves[0] - 1);
      double t;
      if (!enters(bottom[k], top[k], x[n], way[n], start[n], found[n]))
        continue;
      if (leaf < 0)
      {
        stack[size++] = 2 * k + 1;
        stack[size++] = 2 * k + 2;
      }
      else if (order[leaf] >= 0 && order[leaf] != skip[n] &&
               meets(facets[order[leaf]], x[n], way[n], &t) && t > start[n] && t < found[n])
      {
        found[n] = t;
        which[n] = order[leaf];
      }
    }
  }
}

/* Nearest point to x on the triangle or side a, b, c, as a square distance; c is not used in the plane. */
static double nearest_on(const double* a, const double* b, const double* c, const vector x, vector y)
{
  vector from, one;
  minus(x, a, from);
  minus(b, a, one);
#if DIM == 3
  vector two, n, p, q;
  minus(c, a, two);
  cross(one, two, n);
  double area = dot(n, n);
  cross(from, two, p);
  cross(one, from, q);
  double u = dot(p, n) / area, v = dot(q, n) / area;
  if (u >= 0 && v >= 0 && u + v <= 1)
  {
    for (int i = 0; i < 3; ++i)
      y[i] = a[i] + u * one[i] + v * two[i];
    minus(x, y, from);
    return dot(from, from);
  }
  const double *start[] = {a, b, c}, *end[] = {b, c, a};
  int sides = 3;
#else
  const double *start[] = {a}, *end[] = {b};
  int sides = 1;
#endif
  double least = INFINITY;
  for (int s = 0; s < sides; ++s)
  {
    vector at, away;
    minus(end[s], start[s], one);
    minus(x, start[s], from);
    double u = fmin(fmax(dot(from, one) / dot(one, one), 0), 1);
    for (int i = 0; i < DIM; ++i)
      at[i] = start[s][i] + u * one[i];
    minus(x, at, away);
    if (dot(away, away) < least)
    {
      least = dot(away, away);
      for (int i = 0; i < DIM; ++i)
        y[i] = at[i];
    }
  }
  return least;
}

/* The nearest points on facets, no farther than `most`: points, distances, and facets, -1 for none. */
void nearest(long count, const vector x[], const double most[], const long leaves[1],
             const vector bottom[], const vector top[], const long order[], const facet facets[],
             vector points[], double found[], long which[])
{
  for (long n = 0; n < count; ++n)
  {
    long stack[DEPTH] = {0};
    int size = 1;
    double least = most[n] * most[n];
    which[n] = -1;
    while (size)
    {
      long k = stack[--size], leaf = k - (leaves[0] - 1);
      double away = 0, ahead[2] = {0, 0};
      for (int i = 0; i < DIM; ++i)
      {
        double a = fmax(fmax(bottom[k][i] - x[n][i], x[n][i] - top[k][i]), 0);
        away += a * a;
      }
      if (away > least)
        continue;
      if (leaf < 0)
      {
        /* The nearer child first. */
        for (int child = 0; child < 2; ++child)
          for (int i = 0; i < DIM; ++i)
          {
            const long c = 2 * k + 1 + child;
            double a = fmax(fmax(bottom[c][i] - x[n][i], x[n][i] - top[c][i]), 0);
            ahead[child] += a * a;
          }
        int later = ahead[0] <= ahead[1];
        stack[size++] = 2 * k + 1 + later;
        stack[size++] = 2 * k + 2 - later;
        continue;
      }
      if (order[leaf] < 0)
        continue;
      const double(*f)[DIM] = facets[order[leaf]];
      for (int c = 1; c + 1 < (CORNERS > 2 ? CORNERS : 3); ++c)
      {
        vector y = {0};
        double square = nearest_on(f[0], f[c], f[(c + 1) % CORNERS], x[n], y);
        if (square < least || (square <= least && which[n] < 0))
        {
          least = square;
          which[n] = order[leaf];
          for (int i = 0; i < DIM; ++i)
            points[n][i] = y[i];
        }
      }
    }
    found[n] = sqrt(least);
  }
}

/* Facets whose normals are opposite, n.n < -`opposite`, to those of others with centres x, normals and
   radii, whose spheres, as those around nodes, radius -1 for none, are not beside each other seen along these normals, and no farther than
   `ahead` along them or `behind`: numbers of the others, and, if `starts` is given, the facets, those of n
   from starts[n] on. */
void opposite(long count, const vector x[], const vector normals[], const double radii[],
              const double ahead[], const double behind[], const double angle[1], const long leaves[1],
              const vector middles[], const double around[], const long order[], const vector centres[],
              const vector others[], const double sizes[], const long starts[], long numbers[],
              long found[])
{
  for (long n = 0; n < count; ++n)
  {
    long stack[DEPTH] = {0};
    int size = 1;
    numbers[n] = 0;
    while (size)
    {
      long k = stack[--size], leaf = k - (leaves[0] - 1);
      vector middle, half;
      double radius;
      if (leaf < 0)
      {
        if (!(around[k] >= 0))
          continue;
        minus(middles[k], x[n], middle);
        radius = around[k];
      }
      else
      {
        long f = order[leaf];
        if (f < 0 || !(dot(normals[n], others[f]) < -angle[0]))
          continue;
        minus(centres[f], x[n], middle);
        radius = sizes[f];
      }
      double along = dot(middle, normals[n]), both = radii[n] + radius;
      if (along - both > ahead[n] || -along - both > behind[n])
        continue;
      for (int i = 0; i < DIM; ++i)
        half[i] = middle[i] - along * normals[n][i];
      if (dot(half, half) > both * both)
        continue;
      if (leaf < 0)
      {
        stack[size++] = 2 * k + 1;
        stack[size++] = 2 * k + 2;
        continue;
      }
      if (starts)
        found[starts[n] + numbers[n]] = order[leaf];
      ++numbers[n];
    }
  }
}
