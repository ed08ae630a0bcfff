/* Intersections of convex polygons in the plane, and their pieces. Compiled with CORNERS, of the
   polygons that meet: 3 or 4. */

#include <math.h>
#include <string.h>

/* Room for corners: a line that n sides cross, by rounding where it lies on some, adds n/2 at most,
   which makes 4, 6, 9 of 3 and 6, 9, 13, 19 of 4. Every piece takes one corner. */
enum { MOST = 5 * CORNERS, PIECES = MOST - CORNERS + 1 };

typedef double point[2];

/* Twice the area of the triangle a, b, c, positive counterclockwise. */
static double area(const point a, const point b, const point c)
{
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/* The part of a polygon of `count` corners to the left of the line from `start` to `end`, by
   Sutherland and Hodgman: every side gives its start, if that is inside, and where it crosses the
   line. Returns its number of corners. */
static int cut_off(const point start, const point end, int count, const point given[], point kept[])
{
  int size = 0;
  for (int k = 0; k < count; ++k)
  {
    const double *a = given[k], *b = given[(k + 1) % count];
    double here = area(start, end, a), there = area(start, end, b);
    if (here >= 0)
      memcpy(kept[size++], a, sizeof(point));
    if ((here >= 0) != (there >= 0))
    {
      double share = here / (here - there);
      for (int i = 0; i < 2; ++i)
        kept[size][i] = a[i] + share * (b[i] - a[i]);
      ++size;
    }
  }
  return size;
}

/* Leave out corners that are no farther than `least` from the next one. */
static int without_repeated(double least, int count, const point given[], point kept[])
{
  int size = 0;
  for (int k = 0; k < count; ++k)
  {
    const double *a = given[k], *b = given[(k + 1) % count];
    if (fmax(fabs(b[0] - a[0]), fabs(b[1] - a[1])) > least)
      memcpy(kept[size++], a, sizeof(point));
  }
  return size;
}

/* Intersections of `count` pairs of polygons, the first ones counterclockwise; two corners are the
   same within `same[0]` times the largest coordinate of the first polygon. */
void clipped(long count, const point one[][CORNERS], const point two[][CORNERS], const double same[1],
             point corners[][MOST], long counts[])
{
  for (long n = 0; n < count; ++n)
  {
    point work[2][MOST];
    int size = CORNERS, now = 0;
    double largest = 0;
    memcpy(work[0], two[n], sizeof(two[n]));
    for (int k = 0; k < CORNERS; ++k)
    {
      largest = fmax(largest, fmax(fabs(one[n][k][0]), fabs(one[n][k][1])));
      size = cut_off(one[n][k], one[n][(k + 1) % CORNERS], size, work[now], work[1 - now]);
      now = 1 - now;
    }
    counts[n] = without_repeated(same[0] * largest, size, work[now], corners[n]);
  }
}

/* Which of two corners comes off a polygon first: that with the smaller triangle, else with the
   shorter side that is left, else the one farther from the centre of the first facet, which is the
   origin, else from that of the second; of two that mirror each other in both facets the first one
   counterclockwise. Differences below `least` are rounding, so that the pieces do not depend on axes
   or on the first corner. */
static int before(double least, int size, point given[], const point second, int one, int other)
{
  double measures[2][4];
  int corners[2] = {one, other};
  for (int i = 0; i < 2; ++i)
  {
    const double *a = given[(corners[i] + size - 1) % size], *b = given[corners[i]],
                 *c = given[(corners[i] + 1) % size];
    measures[i][0] = fabs(area(b, c, a));
    measures[i][1] = (c[0] - a[0]) * (c[0] - a[0]) + (c[1] - a[1]) * (c[1] - a[1]);
    measures[i][2] = -(b[0] * b[0] + b[1] * b[1]);
    double x = b[0] - second[0], y = b[1] - second[1];
    measures[i][3] = -(x * x + y * y);
  }
  for (int m = 0; m < 4; ++m)
    if (fabs(measures[0][m] - measures[1][m]) > least)
      return measures[0][m] < measures[1][m];
  const double *b = given[one], *c = given[other];
  return b[0] * c[1] - b[1] * c[0] > least;
}

/* Cut polygons into pieces of CORNERS corners: corners whose triangles with their neighbours are
   the smallest come off first. In triangles of four corners the one repeated is the one cut off,
   in the last piece the farthest from the centre of the first facet. Polygons are used up. Areas
   are the same within `same[0]` times the square of the largest coordinate. `seconds` are the
   centres of the second facets. */
void pieces(long count, point polygons[][MOST], const long counts[], const point seconds[],
            const double same[1], point found[][PIECES][CORNERS], long numbers[])
{
  for (long n = 0; n < count; ++n)
  {
    point* rest = polygons[n];
    int size = counts[n];
    long number = 0;
    double largest = 0;
    for (int j = 0; j < size; ++j)
      largest = fmax(largest, fmax(fabs(rest[j][0]), fabs(rest[j][1])));
    double least = same[0] * largest * largest;
    for (; size > CORNERS; --size, ++number)
    {
      int k = 0;
      for (int j = 1; j < size; ++j)
        if (before(least, size, rest, seconds[n], j, k))
          k = j;
      for (int j = 0; j < CORNERS; ++j)
      {
        int at = k + size + (j == 0 ? -1 : j == CORNERS - 1 ? 1 : 0);
        memcpy(found[n][number][j], rest[at % size], sizeof(point));
      }
      memmove(rest[k], rest[k + 1], (size - 1 - k) * sizeof(point));
    }
    int far = 0;
    for (int j = 1; j < size; ++j)
    {
      const double *b = rest[j], *c = rest[far];
      double off = b[0] * b[0] + b[1] * b[1] - c[0] * c[0] - c[1] * c[1];
      if (off > least || (off >= -least && b[0] * c[1] - b[1] * c[0] > least))
        far = j;
    }
    for (int j = 0; size > 2 && j < CORNERS; ++j)
      memcpy(found[n][number][j], rest[(far + (j < size ? j : 0)) % size], sizeof(point));
    numbers[n] = number + (size > 2);
  }
}
