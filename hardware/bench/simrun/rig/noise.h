// SPDX-License-Identifier: GPL-3.0-or-later
// A bad cable.
#ifndef NOISE_H
#define NOISE_H

#include <stdint.h>

enum direction { RX, TX };  // seen from the controller
struct noise {
    double corrupt, drop, duplicate;
};
extern struct noise noise[2];
void noise_seed(uint64_t seed);
double noise_uniform(void);
// Puts the bytes that arrive for one sent byte into out[2] and returns their number: 0, 1 or 2.
int noise_apply(enum direction direction, uint8_t byte, uint8_t out[2]);

#endif
