// Network: the forward pass of a policy, its weights packed for network.h.
#include <nanobind/nanobind.h>

#include <algorithm>
#include <vector>

#include "check.h"

extern "C" {
#include "network.h"
}

namespace nb = nanobind;

namespace {
struct Layer {
    size_t inputs, outputs, panels;
    std::vector<float> weights, biases, out;
};

Layer packed(const float *weights, const float *biases, size_t inputs, size_t outputs) {
    const size_t panels = (outputs + NETWORK_PANEL - 1) / NETWORK_PANEL;
    const size_t width = panels * NETWORK_PANEL;
    Layer l{inputs,
            outputs,
            panels,
            std::vector<float>(width * inputs),
            std::vector<float>(width),
            std::vector<float>(width)};
    for (size_t o = 0; o < outputs; ++o) {
        float *panel = l.weights.data() + o / NETWORK_PANEL * NETWORK_PANEL * inputs + o % NETWORK_PANEL;
        for (size_t i = 0; i < inputs; ++i) panel[i * NETWORK_PANEL] = weights[o * inputs + i];
    }
    std::copy(biases, biases + outputs, l.biases.begin());
    return l;
}

class Network {
  public:
    void add(const appl::Array &weights, const appl::Array &biases) {
        const long inputs = layers_.empty() ? -1 : long(layers_.back().outputs);
        const float *w = appl::checked<const float>(weights, "weights", {-1, inputs});
        const float *b = appl::checked<const float>(biases, "biases", {long(weights.shape(0))});
        layers_.push_back(packed(w, b, weights.shape(1), weights.shape(0)));
    }

    void act(const appl::Array &observation, const appl::Array &action) {
        if (layers_.empty()) throw nb::value_error("act: the network has no layers; add one first");
        Layer &last = layers_.back();
        const float *x = appl::checked<const float>(observation, "observation", {long(layers_.front().inputs)});
        float *to = appl::checked<float>(action, "action", {long(last.outputs)});
        for (Layer &l : layers_) {
            network_layer(l.weights.data(), l.biases.data(), x, l.inputs, l.panels, &l != &last, l.out.data());
            x = l.out.data();
        }
        network_tanh(last.out.data(), last.outputs);
        std::copy(last.out.begin(), last.out.begin() + long(last.outputs), to);
    }

  private:
    std::vector<Layer> layers_;
};
}  // namespace

void bind_policy(nb::module_ &m) {
    nb::class_<Network>(m, "Network", "Layers of ReLU, tanh after the last; see network.h. Not thread-safe.")
        .def(nb::init<>())
        .def("add", &Network::add, nb::arg("weights"), nb::arg("biases"))
        .def("act", &Network::act, nb::arg("observation"), nb::arg("action"));
}
