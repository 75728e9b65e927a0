// Fits of quadrics to the moments around each vertex: one 10x10 system per lane.
#include <limits>

#include "arrays.h"
#include "constants.h"
#include "pairs.h"
#include "threads.h"

namespace hpc {
namespace {

using namespace constants::hermite;

constexpr int value_column(int i, int j) {
  const int* p = EXPONENTS[i].power;
  const int* q = EXPONENTS[j].power;
  return column_of(p[0] + q[0], p[1] + q[1], p[2] + q[2]);
}

// Return the mean of phi_i phi_j over [-1, 1]^3.
constexpr double mean_product(int i, int j) {
  double mean = 1.0;
  for (int axis = 0; axis < 3; ++axis) {
    const int power = EXPONENTS[i].power[axis] + EXPONENTS[j].power[axis];
    mean *= power % 2 ? 0.0 : 1.0 / (power + 1);
  }
  return mean;
}

struct Pair {
  int value, terms, column[3];
  double factor[3], gram;
};

// For each entry of the lower triangle, which moments it is made of.
struct PairTable {
  Pair at[BASIS][BASIS];
  constexpr PairTable() : at() {
    for (int i = 0; i < BASIS; ++i)
      for (int j = 0; j < BASIS; ++j) {
        Pair pair{value_column(i, j), 0, {0, 0, 0}, {0.0, 0.0, 0.0}, mean_product(i, j)};
        for (int axis = 0; axis < 3; ++axis) {
          int power[3] = {0, 0, 0};
          for (int a = 0; a < 3; ++a) power[a] = EXPONENTS[i].power[a] + EXPONENTS[j].power[a];
          power[axis] -= 2;
          const int factor = EXPONENTS[i].power[axis] * EXPONENTS[j].power[axis];
          if (!factor) continue;
          pair.factor[pair.terms] = factor;
          pair.column[pair.terms++] = column_of(power[0], power[1], power[2]);
        }
        at[i][j] = pair;
      }
  }
};

constexpr PairTable PAIRS;

using Matrix = double[BASIS][BASIS][LANES];
using Vector = double[BASIS][LANES];

// Entries of the lower triangle are numbered row by row. All that goes through them does so at
// compile time: an entry is made of few moments, and to look up which would take longer.
constexpr int ENTRIES = BASIS * (BASIS + 1) / 2;
using Entries = std::make_integer_sequence<int, ENTRIES>;

constexpr int row_of(int entry) {
  int row = 0;
  while ((row + 1) * (row + 2) / 2 <= entry) ++row;
  return row;
}
constexpr int column_in(int entry) { return entry - row_of(entry) * (row_of(entry) + 1) / 2; }

template <int ENTRY>
HPC_INLINE void fill_entry(const Block& rows, const double (&factors)[5][LANES], const double (&mu)[LANES],
                           const double (&inverse)[LANES], Matrix& matrix) {
  constexpr Pair pair = PAIRS.at[row_of(ENTRY)][column_in(ENTRY)];
  double sum[LANES];
  EACH_LANE sum[lane] = rows[pair.value][lane];
  for (int term = 0; term < pair.terms; ++term) {
    const double* factor = factors[static_cast<int>(pair.factor[term])];
    const double* from = rows[pair.column[term]];
    EACH_LANE sum[lane] += factor[lane] * from[lane];
  }
  if constexpr (pair.gram != 0.0) EACH_LANE sum[lane] += mu[lane] * pair.gram;
  EACH_LANE matrix[row_of(ENTRY)][column_in(ENTRY)][lane] = sum[lane] * inverse[lane];
}

template <int... ENTRY>
HPC_INLINE void fill_entries(const Block& rows, const double (&factors)[5][LANES], const double (&mu)[LANES],
                             const double (&inverse)[LANES], Matrix& matrix, std::integer_sequence<int, ENTRY...>) {
  (fill_entry<ENTRY>(rows, factors, mu, inverse, matrix), ...);
}

// Add what the prior says about the means over the cube of a basis function times all others.
template <int I, int J>
HPC_INLINE void add_prior(const Vector& prior, const double (&mu)[LANES], double* sum) {
  constexpr double gram = PAIRS.at[I][J].gram;
  if constexpr (gram != 0.0) EACH_LANE sum[lane] += (mu[lane] * gram) * prior[J][lane];
}

template <int I, int... J>
HPC_INLINE void add_priors(const Vector& prior, const double (&mu)[LANES], double* sum, std::integer_sequence<int, J...>) {
  (add_prior<I, J>(prior, mu, sum), ...);
}

template <int... I>
HPC_INLINE void fill_right(const Block& rows, const Vector& prior, const double (&lam)[LANES], const double (&mu)[LANES],
                           const double (&inverse)[LANES], Vector& right, std::integer_sequence<int, I...> all) {
  for (int i = 0; i < BASIS; ++i) EACH_LANE right[i][lane] = i ? lam[lane] * rows[MONOMIALS + i - 1][lane] : 0.0;
  (add_priors<I>(prior, mu, right[I], all), ...);
  for (int i = 0; i < BASIS; ++i) EACH_LANE right[i][lane] *= inverse[lane];
}

HPC_INLINE void fill_equations(const Block& rows, const Vector& prior, const double (&lam)[LANES],
                               const double (&mu)[LANES], Matrix& matrix, Vector& right) {
  double inverse[LANES], factors[5][LANES];
  EACH_LANE inverse[lane] = 1.0 / rows[0][lane];
  for (int factor = 0; factor < 5; ++factor) EACH_LANE factors[factor][lane] = lam[lane] * factor;
  fill_entries(rows, factors, mu, inverse, matrix, Entries());
  for (int i = 0; i < BASIS; ++i) EACH_LANE matrix[i][i][lane] += RIDGE;
  fill_right(rows, prior, lam, mu, inverse, right, std::make_integer_sequence<int, BASIS>());
}

// Find one entry of L D L^T: below the diagonal stays L D, above it comes L, aside the inverse of D.
template <int I, int J>
HPC_INLINE void factor_entry(Matrix& matrix, Vector& inverse) {
  double sum[LANES];
  EACH_LANE sum[lane] = matrix[I][J][lane];
  for (int k = 0; k < J; ++k) EACH_LANE sum[lane] -= matrix[k][I][lane] * matrix[J][k][lane];
  if constexpr (I == J) {
    EACH_LANE inverse[J][lane] = 1.0 / sum[lane];
  } else {
    EACH_LANE matrix[I][J][lane] = sum[lane];
    EACH_LANE matrix[J][I][lane] = sum[lane] * inverse[J][lane];
  }
}

template <int... ENTRY>
HPC_INLINE void factorize(Matrix& matrix, Vector& inverse, std::integer_sequence<int, ENTRY...>) {
  (factor_entry<row_of(ENTRY), column_in(ENTRY)>(matrix, inverse), ...);
}

HPC_INLINE void solve(Matrix& matrix, Vector& right) {
  Vector inverse;
  factorize(matrix, inverse, Entries());
  for (int j = 0; j < BASIS; ++j)
    for (int i = j + 1; i < BASIS; ++i) EACH_LANE right[i][lane] -= matrix[j][i][lane] * right[j][lane];
  for (int j = 0; j < BASIS; ++j) EACH_LANE right[j][lane] *= inverse[j][lane];
  for (int j = BASIS - 1; j >= 0; --j)
    for (int i = 0; i < j; ++i) EACH_LANE right[i][lane] -= matrix[i][j][lane] * right[j][lane];
}

// What the fits of a range read and write.
struct Fits {
  const float *prior, *noise, *lam;
  double least_mu, most_mu;
  float *coefficients, *counts, *variances, *misfits;
};

template <int ENTRY>
HPC_INLINE void add_squares(const Block& rows, const Vector& c, double (&residual)[LANES], double (&slope)[LANES]) {
  constexpr int i = row_of(ENTRY), j = column_in(ENTRY);
  constexpr Pair pair = PAIRS.at[i][j];
  double product[LANES];
  EACH_LANE product[lane] = (i == j ? 1.0 : 2.0) * c[i][lane] * c[j][lane];
  EACH_LANE residual[lane] += product[lane] * rows[pair.value][lane];
  for (int term = 0; term < pair.terms; ++term)
    EACH_LANE slope[lane] += pair.factor[term] * product[lane] * rows[pair.column[term]][lane];
}

template <int... ENTRY>
HPC_INLINE void add_all_squares(const Block& rows, const Vector& c, double (&residual)[LANES], double (&slope)[LANES],
                                std::integer_sequence<int, ENTRY...>) {
  (add_squares<ENTRY>(rows, c, residual, slope), ...);
}

// Find the mean squared distances of the points from the quadrics' surfaces, and the sums of |grad f|^2.
HPC_INLINE void mean_squares(const Block& rows, const Vector& c, double (&squares)[LANES], double (&slope)[LANES]) {
  double residual[LANES] = {};
  EACH_LANE slope[lane] = 0.0;
  add_all_squares(rows, c, residual, slope, Entries());
  EACH_LANE {
    const double least = LEAST_SLOPE * rows[0][lane];
    const double steep = slope[lane] > least ? slope[lane] : least;
    squares[lane] = (residual[lane] > 0.0 ? residual[lane] : 0.0) / steep;
  }
}

// Fit quadrics with priors of some weights.
HPC_INLINE void fit_rows(const Block& rows, const Vector& prior, const double (&lam)[LANES],
                         const double (&mu)[LANES], Vector& fitted) {
  Matrix matrix;
  fill_equations(rows, prior, lam, mu, matrix, fitted);
  solve(matrix, fitted);
}

// Weigh each prior by how well it explains the points.
HPC_INLINE void weigh_priors(const Block& rows, const Vector& prior, const double (&noise)[LANES],
                             const double (&lam)[LANES], const Fits& fits, double (&mu)[LANES]) {
  double missed[LANES], left[LANES] = {}, slope[LANES];
  mean_squares(rows, prior, missed, slope);
  bool rich = false;
  EACH_LANE rich |= rows[0][lane] >= LEAST_POINTS;
  if (rich) {
    Vector fitted;
    EACH_LANE mu[lane] = fits.least_mu;
    fit_rows(rows, prior, lam, mu, fitted);
    mean_squares(rows, fitted, left, slope);
  }
  EACH_LANE {
    const double count = rows[0][lane];
    const double own_noise = (left[lane] * count + TOLD_POINTS * noise[lane]) / (count - BASIS + TOLD_POINTS);
    const bool own = count >= LEAST_POINTS;
    const double gain = missed[lane] - left[lane] - own_noise * (CHANCE_GAIN / count);
    const double beyond = missed[lane] - noise[lane] * (1.0 + std::sqrt(2.0 / count));
    const double excess = own ? gain : beyond;
    const double scale = own ? OWN_WEIGHT * own_noise : noise[lane];
    const double weight = scale / (excess > LEAST_EXCESS ? excess : LEAST_EXCESS);
    const double bounded = weight < fits.most_mu ? weight : fits.most_mu;
    mu[lane] = bounded > fits.least_mu ? bounded : fits.least_mu;
  }
}

// Tell the noise of the points from what the fits leave over, and how far their gradients are off.
HPC_INLINE void measure_residuals(const Block& rows, const Vector& fitted, const Fits& fits,
                                  int64_t start, int width) {
  double squares[LANES], slope[LANES], along[LANES] = {};
  mean_squares(rows, fitted, squares, slope);
  for (int i = 1; i < BASIS; ++i) EACH_LANE along[lane] += fitted[i][lane] * rows[MONOMIALS + i - 1][lane];
  for (int lane = 0; lane < width; ++lane) {
    const double count = rows[0][lane];
    fits.variances[start + lane] = count >= LEAST_POINTS
                                       ? static_cast<float>(squares[lane] * (count / (count - BASIS)))
                                       : std::numeric_limits<float>::quiet_NaN();
    const double misfit = (slope[lane] - 2.0 * along[lane]) / count + 1.0;
    fits.misfits[start + lane] = static_cast<float>(std::max(misfit, 0.0));
  }
}

HPC_INLINE void fit_block(const Block& rows, const Fits& fits, int64_t start, int width) {
  Vector prior, right;
  double noise[LANES], lam[LANES], mu[LANES];
  EACH_LANE {
    const int64_t row = start + std::min(lane, width - 1);
    noise[lane] = fits.noise[row];
    lam[lane] = fits.lam[row];
    for (int i = 0; i < BASIS; ++i) prior[i][lane] = fits.prior[row * BASIS + i];
  }
  weigh_priors(rows, prior, noise, lam, fits, mu);
  fit_rows(rows, prior, lam, mu, right);
  measure_residuals(rows, right, fits, start, width);
  for (int lane = 0; lane < width; ++lane)
    for (int i = 0; i < BASIS; ++i) fits.coefficients[(start + lane) * BASIS + i] = static_cast<float>(right[i][lane]);
}

HPC_CLONES void store_sums(CornerSums& sums, const int64_t* corners, int64_t start, int64_t stop, double* total) {
  Block block;
  for (; start < stop; start += LANES) {
    const int width = static_cast<int>(std::min<int64_t>(LANES, stop - start));
    sums.load(corners + start, width, block);
    for (int lane = 0; lane < width; ++lane)
      for (int column = 0; column < COLUMNS; ++column)
        total[(start + lane) * COLUMNS + column] = block[column][lane];
  }
}

HPC_CLONES void fit_layer(CornerSums& sums, const int64_t* corners, const Fits& fits, int64_t start, int64_t stop) {
  Block block;
  for (; start < stop; start += LANES) {
    const int width = static_cast<int>(std::min<int64_t>(LANES, stop - start));
    sums.load(corners + start, width, block);
    for (int lane = 0; lane < width; ++lane) fits.counts[start + lane] = static_cast<float>(block[0][lane]);
    fit_block(block, fits, start, width);
  }
}

Output<double> corner_moments(Integers touched_of, Integers cells_of, Doubles moments_of, int64_t threads) {
  const int64_t* touched = check_keys(touched_of, "touched");
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t count = rows_of(touched_of), known = rows_of(cells_of);
  const double* moments = check<double>(moments_of, "moments", {known, COLUMNS});
  const int workers = check_threads(threads);
  auto total = make_buffer<double>(count * COLUMNS);
  {
    const Unlocked unlocked;
    run_ranges(count, workers, [&](int64_t start, int64_t stop) {
      CornerSums sums(cells, known, moments);
      visit_layers(sums, touched, start, stop,
                   [&](int64_t from, int64_t to) { store_sums(sums, touched, from, to, total.get()); });
    });
  }
  return give(std::move(total), {static_cast<size_t>(count), COLUMNS});
}

nb::tuple fit_corners(Integers touched_of, Integers cells_of, Doubles moments_of, Singles prior_of,
                      Singles noise_of, Singles lam_of, double least_mu, double most_mu, int64_t threads) {
  const int64_t* touched = check_keys(touched_of, "touched");
  const int64_t* cells = check_keys(cells_of, "cells");
  const int64_t count = rows_of(touched_of), known = rows_of(cells_of);
  const double* moments = check<double>(moments_of, "moments", {known, COLUMNS});
  auto coefficients = make_buffer<float>(count * BASIS);
  auto counts = make_buffer<float>(count);
  auto variances = make_buffer<float>(count);
  auto misfits = make_buffer<float>(count);
  const Fits fits{check<float>(prior_of, "prior", {count, BASIS}),
                  check<float>(noise_of, "noise", {count}),
                  check<float>(lam_of, "lam", {count}),
                  least_mu,
                  most_mu,
                  coefficients.get(),
                  counts.get(),
                  variances.get(),
                  misfits.get()};
  const int workers = check_threads(threads);
  {
    const Unlocked unlocked;
    run_ranges(count, workers, [&](int64_t start, int64_t stop) {
      CornerSums sums(cells, known, moments);
      visit_layers(sums, touched, start, stop,
                   [&](int64_t from, int64_t to) { fit_layer(sums, touched, fits, from, to); });
    });
  }
  const size_t rows = static_cast<size_t>(count);
  return nb::make_tuple(give(std::move(coefficients), {rows, BASIS}), give(std::move(counts), {rows}),
                        give(std::move(variances), {rows}), give(std::move(misfits), {rows}));
}

Output<double> evaluate_residuals(Doubles moments_of, Doubles coefficients_of) {
  const double* moments = check<double>(moments_of, "moments", {ANY, COLUMNS});
  const int64_t count = rows_of(moments_of);
  const double* coefficients = check<double>(coefficients_of, "coefficients", {count, BASIS});
  auto residuals = make_buffer<double>(count);
  for (int64_t row = 0; row < count; ++row) {
    const double* c = coefficients + row * BASIS;
    double total = 0.0;
    for (int j = 0; j < BASIS; ++j)
      for (int i = j; i < BASIS; ++i)
        total += (i == j ? 1.0 : 2.0) * c[i] * c[j] * moments[row * COLUMNS + PAIRS.at[i][j].value];
    residuals[row] = std::max(total, 0.0);
  }
  return give(std::move(residuals), {static_cast<size_t>(count)});
}

}  // namespace

HPC_KERNELS {
  module.def("corner_moments", &corner_moments, "touched"_a, "cells"_a, "moments"_a, "threads"_a = 1);
  module.def("fit_corners", &fit_corners, "touched"_a, "cells"_a, "moments"_a, "prior"_a, "noise"_a, "lam"_a,
             "least_mu"_a, "most_mu"_a, "threads"_a = 1);
  module.def("evaluate_residuals", &evaluate_residuals, "moments"_a, "coefficients"_a);
}

}  // namespace hpc
