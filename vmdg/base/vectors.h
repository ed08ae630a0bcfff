/* Shape functions of a cell in vector registers. Compiled with NODES, of a cell. */

/* Numbers in a vector register. */
#if defined(__AVX512F__) && NODES % 8 == 0
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif

enum { CHUNKS = (NODES + LANES - 1) / LANES };

/* Some shape functions; of a cell there are CHUNKS, filled up with zeros. Vectors of gcc and clang. */
typedef double chunk __attribute__((vector_size(LANES * sizeof(double))));
typedef chunk shapes[CHUNKS];
