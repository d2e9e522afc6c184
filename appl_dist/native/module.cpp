// The one native module. Each part of the C core has a bind_*.cpp that adds its functions here.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_loop(nb::module_ &m);
void bind_planner(nb::module_ &m);
void bind_policy(nb::module_ &m);
void bind_sim(nb::module_ &m);

NB_MODULE(_native, m) {
    m.doc() = "C core of appl_dist: planner kernels, lidar, tyre model, the loop of both and the policy network.";
    bind_loop(m);
    bind_planner(m);
    bind_policy(m);
    bind_sim(m);
}
