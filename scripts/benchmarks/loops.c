/* Sum over loops by hand: the yardstick of `python -m scripts.benchmarks.kernel`, with the formulas of estimator/field/kernel.py.

   A vector of points stays in registers while all loops pass. AVX-512 where the processor has it, else AVX2. */
#include <immintrin.h>
#include <stddef.h>

#ifdef __AVX512F__
#define LANES 8
typedef __m512d vec;
static inline vec root(vec a) { return _mm512_sqrt_pd(a); }
static inline vec all(double a) { return _mm512_set1_pd(a); }
#else
#define LANES 4
typedef __m256d vec;
static inline vec root(vec a) { return _mm256_sqrt_pd(a); }
static inline vec all(double a) { return _mm256_set1_pd(a); }
#endif

int lanes(void) { return LANES; }

/* points: x, y, z of each point, n_points a multiple of lanes(); field likewise. */
void sum_of_loops(const double *points, size_t n_points, const double *height, const double *radius,
                  const double *weight, size_t n_loops, int steps, double quarter_mu0, double *field) {
    for (size_t start = 0; start < n_points; start += LANES) {
        vec x, y, z, h_sum = all(0.0), axial_sum = all(0.0);
        for (int i = 0; i < LANES; i++) {
            const double *point = points + 3 * (start + i);
            x[i] = point[0], y[i] = point[1], z[i] = point[2];
        }
        const vec y2 = y * y, rho2 = x * x + y2;
        for (size_t loop = 0; loop < n_loops; loop++) {
            const vec a = all(radius[loop]), a2 = a * a, above = z - all(height[loop]), z2 = above * above;
            const vec u = (a - x) * (a + x) - y2 + z2, s = a2 + rho2 + z2, p2 = u * u + 4.0 * rho2 * z2;
            vec product = root(p2);
            const vec mean2 = 0.5 * (s + product);
            vec mean = root(mean2), t = a2 / mean2, square = t * 0.0625, scale = all(32.0);
            for (int step = 0; step < steps; step++) {
                const vec geometric = root(product);
                product = mean * geometric;
                mean = 0.5 * (mean + geometric);
                const vec c = square / mean;
                square = rho2 * c * c;
                t += scale * square;
                scale += scale;
            }
            const vec common = all(weight[loop] * quarter_mu0) / (mean * p2), v = 2.0 * z2 - u;
            h_sum += (4.0 * a2 - s * t) * common * above;
            axial_sum += (2.0 * a2 * u + rho2 * t * v) * common;
        }
        for (int i = 0; i < LANES; i++) {
            double *to = field + 3 * (start + i);
            to[0] = x[i] * h_sum[i], to[1] = y[i] * h_sum[i], to[2] = axial_sum[i];
        }
    }
}
