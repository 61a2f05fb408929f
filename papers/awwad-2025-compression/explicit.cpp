// Central differences of linear neo-Hookean tetrahedra between two plates: what run.py compiles for its slow rows.
// usage: explicit MODEL RESULT, both raw arrays in the order that run.py writes and reads them.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <vector>

struct Model {
  double scalars[9];  // nodes, tetrahedra, is_single, steps, steps of the ramp, gravity, bottom and its way, top and its way
  double top_way;
  std::vector<double> X, mu, kappa, A, B, C, mass, tether;  // mu and kappa [kPa], A B C of a time step, tether [mN/mm]
  std::vector<int> cells, chest;
};

template <class T> void get(std::ifstream &in, T *to, size_t n) { in.read(reinterpret_cast<char *>(to), n * sizeof(T)); }

Model read(const char *name) {
  std::ifstream in(name, std::ios::binary);
  Model m;
  get(in, m.scalars, 9);
  get(in, &m.top_way, 1);
  const size_t n = size_t(m.scalars[0]), e = size_t(m.scalars[1]);
  m.X.resize(3 * n), m.mu.resize(e), m.kappa.resize(e), m.cells.resize(4 * e), m.chest.resize(n);
  get(in, m.X.data(), 3 * n), get(in, m.mu.data(), e), get(in, m.kappa.data(), e);
  for (auto *each : {&m.A, &m.B, &m.C, &m.mass, &m.tether}) each->resize(n), get(in, each->data(), n);
  get(in, m.cells.data(), 4 * e), get(in, m.chest.data(), n);
  return m;
}

template <class real> std::vector<real> as(const std::vector<double> &v) { return {v.begin(), v.end()}; }

template <class real> void integrate(const Model &in, const char *result) {
  const int n = int(in.scalars[0]), m = int(in.scalars[1]);
  const long n_steps = long(in.scalars[3]), n_ramp = long(in.scalars[4]);
  std::vector<real> X = as<real>(in.X), A = as<real>(in.A), B = as<real>(in.B), C = as<real>(in.C);
  std::vector<real> mass = as<real>(in.mass), tether = as<real>(in.tether), G(12 * m), mu(m), kappa(m), force(12 * m);
  std::vector<real> u(3 * n), before(3 * n), next(3 * n);
  std::vector<int> cells(4 * m), first(n + 1), place(4 * m);
  for (int e = 0; e < m; e++) {  // slopes of the shape functions; moduli times volume
    double D[3][3], inverse[3][3];
    for (int a = 0; a < 3; a++)
      for (int i = 0; i < 3; i++) D[i][a] = in.X[3 * in.cells[4 * e + a + 1] + i] - in.X[3 * in.cells[4 * e] + i];
    auto minor = [&](int a, int b, int c, int d) { return D[a][c] * D[b][d] - D[a][d] * D[b][c]; };
    const double det = D[0][0] * minor(1, 2, 1, 2) + D[0][1] * minor(1, 2, 2, 0) + D[0][2] * minor(1, 2, 0, 1);
    for (int a = 0; a < 3; a++)
      for (int j = 0; j < 3; j++) inverse[a][j] = minor((j + 1) % 3, (j + 2) % 3, (a + 1) % 3, (a + 2) % 3) / det;
    for (int j = 0; j < 3; j++) {
      for (int a = 0; a < 3; a++) G[(4 * j + a + 1) * m + e] = real(inverse[a][j]);
      G[4 * j * m + e] = real(-inverse[0][j] - inverse[1][j] - inverse[2][j]);
    }
    mu[e] = real(in.mu[e] * det / 6), kappa[e] = real(in.kappa[e] * det / 6);
    for (int a = 0; a < 4; a++) cells[a * m + e] = in.cells[4 * e + a], first[in.cells[4 * e + a] + 1]++;
  }
  for (int i = 0; i < n; i++) first[i + 1] += first[i];
  std::vector<int> filled(first.begin(), first.end() - 1);
  for (int e = 0; e < m; e++)
    for (int a = 0; a < 4; a++) place[filled[in.cells[4 * e + a]]++] = a * m + e;

  for (long step = 0; step < n_steps; step++) {
#pragma GCC ivdep
    for (int e = 0; e < m; e++) {
      real F[3][3], c[3][3], g[4][3], squares = 0;
      for (int a = 0; a < 4; a++)
        for (int j = 0; j < 3; j++) g[a][j] = G[(4 * j + a) * m + e];
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
          real sum = 0;
          for (int a = 0; a < 4; a++) sum += u[3 * cells[a * m + e] + i] * g[a][j];
          F[i][j] = sum + real(i == j);
          squares += F[i][j] * F[i][j];
        }
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
          const int p = (i + 1) % 3, q = (i + 2) % 3, r = (j + 1) % 3, s = (j + 2) % 3;
          c[i][j] = F[p][r] * F[q][s] - F[p][s] * F[q][r];
        }
      const real J = F[0][0] * c[0][0] + F[0][1] * c[0][1] + F[0][2] * c[0][2], d = J - 1;
      real root = 1 - real(2.0 / 3) * d + real(5.0 / 9) * d * d - real(40.0 / 81) * d * d * d;  // J^(-2/3)
      for (int k = 0; k < 2; k++) root -= (root * root * root * J * J - 1) / (3 * root * root * J * J);
      const real shear = mu[e] * root, pressure = kappa[e] * d - shear * squares / (3 * J);
      for (int i = 0; i < 3; i++)
        for (int a = 0; a < 4; a++) {
          real sum = 0;
          for (int j = 0; j < 3; j++) sum += (shear * F[i][j] + pressure * c[i][j]) * g[a][j];
          force[(4 * i + a) * m + e] = sum;
        }
    }
    const double t = std::min(1.0, double(step + 1) / n_ramp), share = t * t * (10 * t - t * t * (15 - 6 * t));
    const real gravity = real(in.scalars[5] * t);
    const real bottom = real(in.scalars[6] + in.scalars[7] * share), top = real(in.scalars[8] + in.top_way * share);
    for (int i = 0; i < n; i++) {
      for (int k = 0; k < 3; k++) {
        real f = (k == 1 ? mass[i] * gravity : real(0)) - tether[i] * u[3 * i + k];
        for (int q = first[i]; q < first[i + 1]; q++) f -= force[4 * k * m + place[q]];
        next[3 * i + k] = A[i] * f + B[i] * u[3 * i + k] + C[i] * before[3 * i + k];
      }
      if (in.chest[i]) next[3 * i + 2] = 0;
      next[3 * i + 1] = std::clamp(next[3 * i + 1], bottom - X[3 * i + 1], top - X[3 * i + 1]);
    }
    before.swap(u), u.swap(next);
  }
  std::ofstream out(result, std::ios::binary);
  const std::vector<double> told(u.begin(), u.end());
  out.write(reinterpret_cast<const char *>(told.data()), told.size() * sizeof(double));
}

int main(int, char **names) {
  const Model model = read(names[1]);
  model.scalars[2] != 0 ? integrate<float>(model, names[2]) : integrate<double>(model, names[2]);
}
