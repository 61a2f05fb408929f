// Compiled kernels of cicatrix. Each has a NumPy twin of the same name and arguments; core/native.py chooses.
#include <nanobind/nanobind.h>

NB_MODULE(_native, m) { m.doc() = "Compiled kernels of cicatrix."; }
