#include "network.h"

#include "tanh.h"
#include "wide.h"

WIDE void network_layer(const float *restrict weights, const float *restrict biases, const float *restrict x,
                        size_t inputs, size_t panels, int rectified, float *restrict out) {
    for (size_t p = 0; p < panels; ++p) {
        float sum[NETWORK_PANEL] = {0};
        for (size_t i = 0; i < inputs; ++i, weights += NETWORK_PANEL)
            for (int k = 0; k < NETWORK_PANEL; ++k) sum[k] += weights[k] * x[i];
        for (int k = 0; k < NETWORK_PANEL; ++k) {
            const float y = sum[k] + biases[p * NETWORK_PANEL + (size_t)k];
            out[p * NETWORK_PANEL + (size_t)k] = rectified && y < 0 ? 0 : y;
        }
    }
}

void network_tanh(float *x, size_t count) {
    for (size_t i = 0; i < count; ++i) x[i] = (float)portable_tanh(x[i]);
}
