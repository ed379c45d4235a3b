// SPDX-License-Identifier: GPL-3.0-or-later
// Simulated time: cycles that never go back, and how fast they may pass.
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

// Cycles since the start of the log. simavr may begin at 0 again with each reset; this never does.
uint64_t clock_cycles(void);
void clock_begin_at(uint64_t cycles);
void clock_notice_reset(void);
// Waits until the wall clock has caught up with the simulated one; `speed` 0 never waits.
void pace(double speed, double frequency, int wake_fd);

#endif
