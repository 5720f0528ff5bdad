// A network of laser trackers in native Ceres: solve, then the covariance of every station and point.
//
// Usage: network_ceres PROBLEM ANSWER; both binary, 8 bytes a number. PROBLEM: stations, points, rows, want covariance;
// for each row station, point, range, azimuth, zenith angle and their three standard uncertainties; start of each
// station (angle-axis of b in a, then place) and of each point. ANSWER: CPU seconds of the solve and of the covariance,
// cost, iterations; points; covariance (3 x 3) of each point. The first station is held.
#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <ctime>
#include <fstream>
#include <utility>
#include <vector>

struct Sight {
  double range, azimuth, zenith, u[3];
  template <typename T>
  bool operator()(const T* station, const T* point, T* residual) const {
    const T away[3] = {point[0] - station[3], point[1] - station[4], point[2] - station[5]};
    const T back[3] = {-station[0], -station[1], -station[2]};
    T seen[3];
    ceres::AngleAxisRotatePoint(back, away, seen);
    const T level = sqrt(seen[0] * seen[0] + seen[1] * seen[1]);
    // angles from the reading, by the components turned with it: no period to watch
    const T turned_x = cos(azimuth) * seen[0] + sin(azimuth) * seen[1];
    const T turned_y = cos(azimuth) * seen[1] - sin(azimuth) * seen[0];
    const T along = cos(zenith) * seen[2] + sin(zenith) * level;
    const T across = cos(zenith) * level - sin(zenith) * seen[2];
    residual[0] = (sqrt(level * level + seen[2] * seen[2]) - range) / u[0];
    residual[1] = atan2(turned_y, turned_x) / u[1];
    residual[2] = atan2(across, along) / u[2];
    return true;
  }
};

static double now() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int, char** names) {
  std::ifstream in(names[1], std::ios::binary);
  std::vector<double> data;
  for (double x; in.read(reinterpret_cast<char*>(&x), 8);) data.push_back(x);
  const long stations = data[0], points = data[1], rows = data[2];
  const double* row = data.data() + 4;
  double* station = data.data() + 4 + 8 * rows;
  double* point = station + 6 * stations;
  ceres::Problem problem;
  for (long k = 0; k < rows; ++k, row += 8)
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<Sight, 3, 6, 3>(new Sight{row[2], row[3], row[4], {row[5], row[6], row[7]}}),
        nullptr, station + 6 * static_cast<long>(row[0]), point + 3 * static_cast<long>(row[1]));
  problem.SetParameterBlockConstant(station);
  ceres::Solver::Options options;
  options.linear_solver_type = stations > 20 ? ceres::SPARSE_SCHUR : ceres::DENSE_SCHUR;
  options.num_threads = 1;
  options.initial_trust_region_radius = 1e16;  // Gauss-Newton against Gauss-Newton
  options.max_trust_region_radius = 1e32;
  options.function_tolerance = 1e-16;
  options.gradient_tolerance = 1e-16;
  options.parameter_tolerance = 1e-14;
  options.max_num_iterations = 20;
  auto* order = new ceres::ParameterBlockOrdering;
  for (long j = 0; j < points; ++j) order->AddElementToGroup(point + 3 * j, 0);
  for (long i = 0; i < stations; ++i) order->AddElementToGroup(station + 6 * i, 1);
  options.linear_solver_ordering.reset(order);
  ceres::Solver::Summary summary;
  const double begin = now();
  ceres::Solve(options, &problem, &summary);
  std::vector<double> answer = {now() - begin, 0.0, summary.final_cost,
                                static_cast<double>(summary.iterations.size())};
  answer.insert(answer.end(), point, point + 3 * points);
  if (data[3] != 0.0) {
    ceres::Covariance::Options how;
    how.algorithm_type = ceres::SPARSE_QR;
    how.num_threads = 1;
    ceres::Covariance covariance(how);
    std::vector<std::pair<const double*, const double*>> blocks;
    for (long i = 1; i < stations; ++i) blocks.emplace_back(station + 6 * i, station + 6 * i);
    for (long j = 0; j < points; ++j) blocks.emplace_back(point + 3 * j, point + 3 * j);
    const double then = now();
    if (!covariance.Compute(blocks, &problem)) return 1;
    answer[1] = now() - then;
    for (long j = 0; j < points; ++j) {
      double block[9];
      covariance.GetCovarianceBlock(point + 3 * j, point + 3 * j, block);
      answer.insert(answer.end(), block, block + 9);
    }
  }
  std::ofstream out(names[2], std::ios::binary);
  out.write(reinterpret_cast<const char*>(answer.data()), 8 * answer.size());
}
