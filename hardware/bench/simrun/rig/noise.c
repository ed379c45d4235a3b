// SPDX-License-Identifier: GPL-3.0-or-later
// A bad cable: bytes with a flipped bit, lost bytes, bytes twice. The same seed gives the same damage.
#include "noise.h"

#include <stdbool.h>

struct noise noise[2];
static uint64_t state = 0x9E3779B97F4A7C15u;

void noise_seed(uint64_t seed) {
    state = seed * 0x9E3779B97F4A7C15u + 0xD1B54A32D192ED03u;
    if (!state) state = 1;
}

// xorshift64*: small, the same on every machine, good enough to break bytes.
static uint64_t next(void) {
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return state * 0x2545F4914F6CDD1Du;
}

double noise_uniform(void) {
    return (double)(next() >> 11) / 9007199254740992.0;
}

static bool happens(double probability) {
    return probability > 0 && noise_uniform() < probability;
}

int noise_apply(enum direction direction, uint8_t byte, uint8_t out[2]) {
    const struct noise *here = &noise[direction];
    if (happens(here->drop)) return 0;
    if (happens(here->corrupt)) byte ^= (uint8_t)(1u << (next() >> 61));
    out[0] = out[1] = byte;
    return happens(here->duplicate) ? 2 : 1;
}
