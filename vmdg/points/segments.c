/* Intersections of convex polygons in the plane, and their pieces. Compiled with CORNERS, of the
   polygons that meet: 3 or 4. */

#include <float.h>
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

/* Cut polygons into pieces of CORNERS corners, those with fewer by repeating the last one: corners
   whose triangles with their neighbours are the smallest come off first. Polygons are used up. */
void pieces(long count, point polygons[][MOST], const long counts[], point found[][PIECES][CORNERS],
            long numbers[])
{
  for (long n = 0; n < count; ++n)
  {
    point* rest = polygons[n];
    int size = counts[n];
    long number = 0;
    for (; size > CORNERS; --size, ++number)
    {
      int k = 0;
      double least = DBL_MAX;
      for (int j = 0; j < size; ++j)
      {
        double off = fabs(area(rest[j], rest[(j + 1) % size], rest[(j + size - 1) % size]));
        if (off < least)
        {
          least = off;
          k = j;
        }
      }
      for (int j = 0; j < CORNERS; ++j)
      {
        int at = j == 0 ? k + size - 1 : j == 1 ? k : k + 1;
        memcpy(found[n][number][j], rest[at % size], sizeof(point));
      }
      memmove(rest[k], rest[k + 1], (size - 1 - k) * sizeof(point));
    }
    for (int j = 0; size > 2 && j < CORNERS; ++j)
      memcpy(found[n][number][j], rest[j < size ? j : size - 1], sizeof(point));
    numbers[n] = number + (size > 2);
  }
}
