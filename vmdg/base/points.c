/* A kernel of FFCx, evaluated at many points with its coefficients and constants. */

#include <stddef.h>

typedef void kernel(double *, const double *, const double *, const double *, const int *,
                    const unsigned char *);

/* A = kernel(w) at every point; sizes are the numbers of coefficients and of components. */
void evaluate(long count, const double *w, const long *sizes, const double *c,
              const size_t *address, double *A)
{
    kernel *function = (kernel *)address[0];
    for (long p = 0; p < count; p++)
        function(A + p * sizes[1], w + p * sizes[0], c, NULL, NULL, NULL);
}
