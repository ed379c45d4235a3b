// SPDX-License-Identifier: GPL-3.0-or-later
// Orders to the runner by signals, the control socket and the line; the main loop carries them out.
#ifndef ORDERS_H
#define ORDERS_H

#include <signal.h>
#include <stdbool.h>
#include <stdint.h>

struct orders {
    double speed;              // simulated seconds per second, 0: as fast as it goes
    bool autoreset;            // whether opening the port resets the processor
    const char *port_link;
    const char *reset_wanted;  // why, or NULL
    volatile sig_atomic_t stop;
};
extern struct orders orders;
extern uint64_t resets;  // that were carried out

#endif
