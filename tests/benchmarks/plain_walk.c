/* A plain Monte Carlo walk through one matched slab, as MCML does it: the yardstick of bench_phantom.py.
 *
 * Pencil beam at the origin, Henyey-Greenstein scattering, weight times albedo at each scattering, Russian roulette
 * below 1e-4 with one survivor in ten (Wang, Jacques, Zheng 1995). Of what leaves the top face it counts the share of
 * azimuths at which that would be through a square beside the beam, as nailoptics does.
 *
 * Usage: plain_walk photons seed mu_a mu_s g thickness_mm centre_x_mm size_mm
 * Prints: sum of weights, sum of their squares, scatterings, CPU seconds.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static uint64_t state;

/* PCG32 (O'Neill 2014): a float in (0, 1]. */
static inline float uniform(void) {
    uint64_t old = state;
    state = old * 6364136223846793005ULL + 1442695040888963407ULL;
    uint32_t shifted = (uint32_t)(((old >> 18u) ^ old) >> 27u), turn = (uint32_t)(old >> 59u);
    uint32_t bits = (shifted >> turn) | (shifted << ((-turn) & 31u));
    return (float)((bits >> 8) + 1) * 0x1p-24f;
}

/* The share of a circle of radius r around the beam that lies in a square beside it, centre > half. */
static inline float share_of_circle(float r, float centre, float half) {
    if (r <= centre - half) return 0;
    const float outer = acosf(fminf((centre + half) / r, 1));
    const float inner = fminf(acosf((centre - half) / r), asinf(fminf(half / r, 1)));
    return fmaxf(inner - outer, 0) / 3.14159265f;
}

int main(int argc, char **argv) {
    if (argc != 9) {
        fprintf(stderr, "usage: plain_walk photons seed mu_a mu_s g thickness_mm centre_x_mm size_mm\n");
        return 2;
    }
    const long photons = atol(argv[1]);
    const float mu_a = strtof(argv[3], NULL), mu_s = strtof(argv[4], NULL), g = strtof(argv[5], NULL);
    const float thickness = strtof(argv[6], NULL), centre = strtof(argv[7], NULL), half = strtof(argv[8], NULL) / 2;
    const float free_path = 1 / (mu_a + mu_s), albedo = mu_s * free_path;
    state = strtoull(argv[2], NULL, 10) * 0x9E3779B97F4A7C15ULL + 1;
    for (int i = 0; i < 16; i++) uniform();

    double sum = 0, square = 0;
    long scatterings = 0;
    const clock_t start = clock();
    for (long i = 0; i < photons; i++) {
        float x = 0, y = 0, z = 0, ux = 0, uy = 0, uz = 1, weight = 1;
        for (;;) {
            const float step = -logf(uniform()) * free_path, below = z + step * uz;
            if (below < 0) {
                const float part = -z / uz;
                x += part * ux;
                y += part * uy;
                const double counts = weight * share_of_circle(sqrtf(x * x + y * y), centre, half);
                sum += counts;
                square += counts * counts;
                break;
            }
            if (below > thickness) break;
            x += step * ux;
            y += step * uy;
            z = below;
            weight *= albedo;
            scatterings++;
            if (weight < 1e-4f) {
                if (uniform() > 0.1f) break;
                weight *= 10;
            }
            float cosine;
            if (g == 0) {
                cosine = 2 * uniform() - 1;
            } else {
                const float s = (1 - g * g) / (1 - g + 2 * g * uniform());
                cosine = fminf(fmaxf((1 + g * g - s * s) / (2 * g), -1), 1);
            }
            const float sine = sqrtf(1 - cosine * cosine), azimuth = 6.2831853f * uniform();
            const float cos_azimuth = cosf(azimuth), sin_azimuth = sinf(azimuth);
            if (fabsf(uz) > 0.99999f) {
                ux = sine * cos_azimuth;
                uy = sine * sin_azimuth;
                uz = copysignf(cosine, cosine * uz);
            } else {
                const float across = sqrtf(1 - uz * uz);
                const float vx = sine * (ux * uz * cos_azimuth - uy * sin_azimuth) / across + ux * cosine;
                const float vy = sine * (uy * uz * cos_azimuth + ux * sin_azimuth) / across + uy * cosine;
                uz = -sine * cos_azimuth * across + uz * cosine;
                /* Keeps the length at 1 over hundreds of turns. */
                const float grown = 1.5f - 0.5f * (vx * vx + vy * vy + uz * uz);
                ux = vx * grown;
                uy = vy * grown;
                uz *= grown;
            }
        }
    }
    printf("%.17g %.17g %ld %.6f\n", sum, square, scatterings, (double)(clock() - start) / CLOCKS_PER_SEC);
    return 0;
}
