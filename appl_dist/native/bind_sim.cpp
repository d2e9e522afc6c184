#include <nanobind/nanobind.h>
namespace nb = nanobind;
void bind_sim(nb::module_ &) {}
