// Compiled kernels of cicatrix. Each has a NumPy reference implementation; core/native.py chooses between the two.
#include <nanobind/nanobind.h>

void bind_philox(nanobind::module_& m);
void bind_automaton(nanobind::module_& m);
void bind_scatter(nanobind::module_& m);
void bind_switching(nanobind::module_& m);

NB_MODULE(_native, m) {
    m.doc() = "Compiled kernels of cicatrix.";
    bind_philox(m);
    bind_automaton(m);
    bind_scatter(m);
    bind_switching(m);
}
