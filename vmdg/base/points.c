/* A kernel of FFCx, evaluated at many points with its coefficients and constants. */

#include <stddef.h>

typedef void kernel(double *, const double *, const double *, const double *, const int *,
                    const unsigned char *);

/* A = kernel(w, X) at every point; sizes are the numbers of coefficients and of components; X are
   positions, twice as if of the two nodes of an interval, null where the kernel has none. */
void evaluate(long count, const double *w, const long *sizes, const double *c, const double *X,
              const size_t *address, double *A)
{
    kernel *function = (kernel *)address[0];
    for (long p = 0; p < count; p++)
        function(A + p * sizes[1], w + p * sizes[0], c, X ? X + 6 * p : NULL, NULL, NULL);
}
