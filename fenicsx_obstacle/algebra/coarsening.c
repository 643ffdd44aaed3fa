/* Loops over the nodes of a graph that NumPy would make several times slower; coarsening.py says what they are for. */

#include <math.h>
#include <stdint.h>

enum { UNDECIDED, CHOSEN, DROPPED };

#define SMALL 0.05             /* weights of less are dropped */
#define LEAST (-0.2)           /* weights beyond these are extrapolation */
#define MOST 1.2
#define FAR_LEAST (-0.5)       /* weights beyond these are not used at all */
#define FAR_MOST 1.5
#define COINCIDENT 1e-12       /* of the largest squared distance: two nodes at one place */
#define SINGULAR 1e-8          /* of the trace of a covariance: what its eigenvalues are raised by */
#define NEARLY_NOTHING 1e-10   /* the same, where there is one candidate only; distances are at most 1 */

/* Decide about owned nodes as far as the states of ghosts allow; returns how many are left undecided. */
int64_t choose(int64_t nodes, const int64_t *starts, const int32_t *neighbours, const double *priority,
               const int64_t *number, int8_t *state, int32_t *left)
{
    int64_t count = 0, before = -1;
    for (int64_t i = 0; i < nodes; i++)
        if (state[i] == UNDECIDED) left[count++] = (int32_t)i;
    while (count != before) {
        before = count;
        count = 0;
        for (int64_t k = 0; k < before; k++) {
            const int32_t i = left[k];
            int8_t found = CHOSEN;
            for (int64_t e = starts[i]; e < starts[i + 1]; e++) {
                const int32_t j = neighbours[e];
                if (state[j] == CHOSEN) {
                    found = DROPPED;
                    break;
                }
                if (j != i && state[j] == UNDECIDED &&
                    (priority[j] > priority[i] || (priority[j] == priority[i] && number[j] < number[i])))
                    found = UNDECIDED;
            }
            state[i] = found;
            if (found == UNDECIDED) left[count++] = i;
        }
    }
    return count;
}

/* Weights by least squares, near those of `near`, which are not negative, and exact for linear functions as far as the
   candidates allow. */
static void fit(int dim, int count, const double (*x)[3], const double *near, double *weight)
{
    double sum = 0.0, mean[3] = {0.0, 0.0, 0.0}, M[3][3] = {{0.0}}, y[3], trace = 0.0;
    for (int k = 0; k < count; k++) sum += near[k];
    for (int k = 0; k < count; k++) {
        weight[k] = near[k] / sum;
        for (int i = 0; i < dim; i++) mean[i] += weight[k] * x[k][i];
    }
    for (int k = 0; k < count; k++)
        for (int i = 0; i < dim; i++)
            for (int j = 0; j <= i; j++) M[i][j] += weight[k] * (x[k][i] - mean[i]) * (x[k][j] - mean[j]);
    for (int i = 0; i < dim; i++) trace += M[i][i];
    for (int i = 0; i < dim; i++) M[i][i] += SINGULAR * trace + NEARLY_NOTHING;
    /* M y = mean by Cholesky; a pivot is at least what was added, up to round-off */
    for (int i = 0; i < dim; i++) {
        for (int j = 0; j <= i; j++) {
            for (int k = 0; k < j; k++) M[i][j] -= M[i][k] * M[j][k];
            if (j < i) M[i][j] /= M[j][j];
        }
        M[i][i] = sqrt(fmax(M[i][i], 0.5 * NEARLY_NOTHING));
    }
    for (int i = 0; i < dim; i++) {
        y[i] = mean[i];
        for (int k = 0; k < i; k++) y[i] -= M[i][k] * y[k];
        y[i] /= M[i][i];
    }
    for (int i = dim - 1; i >= 0; i--) {
        for (int k = i + 1; k < dim; k++) y[i] -= M[k][i] * y[k];
        y[i] /= M[i][i];
    }
    for (int k = 0; k < count; k++) {
        double height = 1.0;
        for (int i = 0; i < dim; i++) height -= (x[k][i] - mean[i]) * y[i];
        weight[k] *= height;
    }
}

static int within(int count, const double *weight, double least, double most)
{
    for (int k = 0; k < count; k++)
        if (!(weight[k] >= least && weight[k] <= most)) return 0;
    return 1;
}

static void scaled(int count, const double *from, double *weight)
{
    double sum = 0.0;
    for (int k = 0; k < count; k++) sum += from[k];
    for (int k = 0; k < count; k++) weight[k] = from[k] / sum;
}

/* Rows of the interpolation: for each owned node the candidates that are left, and their weights. `columns` and `weights`
   are as long as the candidates; returns how many are used. `work` has room for 8 numbers for each candidate of a node. */
int64_t interpolate(int64_t nodes, int dim, const int64_t *starts, const int32_t *candidates, const double *place,
                    const double *coarse_place, const double *tangents, const int64_t *own_number, const int8_t *fixed,
                    const double *coarse_fixed, const int64_t *numbers, double *work, int64_t longest,
                    int64_t *row_starts, int64_t *columns, double *weights)
{
    double(*x)[3] = (double(*)[3])work, *near = work + 3 * longest, *found = near + longest, *weight = found + longest,
    *size = weight + longest;
    int64_t *which = (int64_t *)(size + longest), used = 0;
    const int axes = tangents ? 3 : dim;
    row_starts[0] = 0;
    for (int64_t n = 0; n < nodes; n++) {
        if (own_number[n] >= 0) { /* a coarse node is itself */
            columns[used] = own_number[n];
            weights[used++] = 1.0;
            row_starts[n + 1] = used;
            continue;
        }
        int count = 0;
        double farthest = 0.0, most = 0.0;
        for (int64_t e = starts[n]; e < starts[n + 1]; e++) {
            const int32_t c = candidates[e];
            double away[3] = {0.0, 0.0, 0.0}, square = 0.0;
            if (fixed[n] && coarse_fixed[c] == 0.0) continue;
            for (int i = 0; i < axes; i++) away[i] = coarse_place[3 * (int64_t)c + i] - place[3 * n + i];
            for (int i = 0; i < dim; i++) {
                x[count][i] = away[i];
                if (tangents) {
                    const double *t = tangents + 3 * (dim * n + i);
                    x[count][i] = t[0] * away[0] + t[1] * away[1] + t[2] * away[2];
                }
                square += x[count][i] * x[count][i];
            }
            size[count] = square;
            which[count++] = numbers[e];
            if (square > farthest) farthest = square;
        }
        const double unit = farthest > 0.0 ? farthest : 1.0;
        for (int k = 0; k < count; k++) {
            const double square = size[k] / unit;
            for (int i = 0; i < dim; i++) x[k][i] /= sqrt(unit);
            near[k] = square > COINCIDENT ? 1.0 / (square * square) : farthest > 0.0 ? 0.0 : 1.0;
        }
        fit(dim, count, x, near, found);
        for (int k = 0; k < count; k++) most = fmax(most, fabs(found[k]));
        int kept = 0;
        for (int k = 0; k < count; k++)
            if (fabs(found[k]) >= fmin(SMALL, most)) {
                for (int i = 0; i < dim; i++) x[kept][i] = x[k][i];
                near[kept] = near[k];
                found[kept] = found[k];
                size[kept] = fabs(found[k]);
                which[kept++] = which[k];
            }
        fit(dim, kept, x, size, weight);
        scaled(kept, weight, weight); /* against the round-off of nearly singular fits */
        if (!within(kept, weight, LEAST, MOST)) scaled(kept, found, weight);
        if (!within(kept, weight, FAR_LEAST, FAR_MOST)) scaled(kept, near, weight);
        for (int k = 0; k < kept; k++) {
            columns[used] = which[k];
            weights[used++] = weight[k];
        }
        row_starts[n + 1] = used;
    }
    return used;
}
