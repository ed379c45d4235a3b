// SPDX-License-Identifier: GPL-3.0-or-later
// Simulated time: cycles that never go back, and how fast they may pass.
#define _GNU_SOURCE
#include "clock.h"

#include <poll.h>
#include <time.h>

#include "processor.h"

static uint64_t base, last;

uint64_t clock_cycles(void) {
    if (avr->cycle < last) base += last;
    last = avr->cycle;
    return base + last;
}

void clock_begin_at(uint64_t cycles) {
    base = cycles;
}

// simavr calls back before it puts its counter to 0, if it does: the elapsed cycles must be counted by then.
void clock_notice_reset(void) {
    clock_cycles();
}

static int64_t wall_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

void pace(double factor, double frequency, int wake_fd) {
    static double paced_at = -1;
    static int64_t wall_start;
    static uint64_t cycle_start;
    uint64_t now = clock_cycles();
    if (factor != paced_at) {
        paced_at = factor;
        wall_start = wall_ns();
        cycle_start = now;
    }
    if (factor <= 0) return;
    int64_t ahead = (int64_t)((double)(now - cycle_start) * 1e9 / frequency / factor) - (wall_ns() - wall_start);
    if (ahead < -100000000) {
        // The machine was busy elsewhere. Running after the lost time would squeeze the host's deadlines.
        wall_start = wall_ns();
        cycle_start = now;
    } else if (ahead > 200000) {
        struct timespec wait = {0, ahead > 1000000 ? 1000000 : ahead};
        struct pollfd wake = {wake_fd, POLLIN, 0};
        // A byte from the host ends the wait, so that it is in the queue when simulated time goes on.
        if (wake_fd >= 0)
            ppoll(&wake, 1, &wait, NULL);
        else
            nanosleep(&wait, NULL);
    }
}
