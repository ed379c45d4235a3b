/* A machine without hardware, for the tests of the portable half: motions and shots end when the test says so.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef FAKE_H
#define FAKE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "machine.h"

struct fake {
    struct machine_status status;
    struct machine_counters counters;
    uint32_t link_ms;      /* until the link counts as lost */
    uint32_t armed_ms;     /* until the contactor opens at rest */
    unsigned laser_asked;  /* calls of machine_laser that switched it on */
    unsigned motions;      /* calls that started one */
    int32_t target;        /* of the last motion */
    uint8_t shot_modes;    /* of the last that was a shot, 0 for an exposure or a test */
    unsigned lit_by_shots[LASERS]; /* lit exposures of each laser that ended */
    char sent[512];        /* bytes written since fake_take */
    size_t sent_length;
    unsigned writes;
};

extern struct fake fake;

void fake_reset(void);        /* a fresh boot: says BOOT */
void fake_fault(uint8_t which);
void fake_byte(uint8_t byte); /* as the receive interrupt and the main loop would take it */
void fake_end(void);          /* the running action ends, with its event */
void fake_pass(uint32_t ms);  /* time passes without input */

#endif
