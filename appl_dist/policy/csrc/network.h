// A policy network's layers with the same bits on every machine: every output is one sum, in the order of the inputs,
// of products that are not fused. Vectors lie across the outputs, so their width changes no sum.
#pragma once
#include <stddef.h>

enum { NETWORK_PANEL = 32 };  // outputs whose sums are kept in registers together

// weights: panels of NETWORK_PANEL outputs, each (inputs, NETWORK_PANEL); biases and out: panels * NETWORK_PANEL.
// out = weights x + biases, and 0 instead of what is negative where `rectified`. None of them overlap.
void network_layer(const float *weights, const float *biases, const float *x, size_t inputs, size_t panels,
                   int rectified, float *out);

// tanh of x[i], in place; at most 1 ulp from the exact value.
void network_tanh(float *x, size_t count);
