// SPDX-License-Identifier: GPL-3.0-or-later
// The serial line.
#ifndef LINE_H
#define LINE_H

#include <stdbool.h>
#include <stdint.h>

struct line_counts {
    uint64_t received, sent, overrun, unheard;
};
extern struct line_counts line_counts;
bool line_plug(const char *link);
void line_unplug(void);
bool line_plugged(void);
bool line_host_present(void);
void line_connect(void);
void line_after_reset(void);
void line_tick(void);
int line_wake_fd(void);

#endif
