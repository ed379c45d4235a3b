/* Settings of motion, link and shots: never kept over a reset, changed all or none.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SETTINGS_H
#define SETTINGS_H

#include <stdbool.h>
#include <stdint.h>

enum setting {
    WD,
    VMAX,
    VST,
    ACC,
    HV,
    BACK,
    DIR_SENSE,
    SHOT_SETTINGS, /* The first setting in the answer to CFG shot=1. */
    SETTL = SHOT_SETTINGS,
    LON,
    LOFF,
    EXP,
    GAP,
    RDY_WAIT,
    SMIN,
    SMAX,
    SETTINGS
};

struct setting_row {
    char name[6];
    int32_t preset, lowest, highest;
};

extern const struct setting_row setting_rows[SETTINGS]; /* in flash */
extern int32_t settings[SETTINGS];                      /* changed only while the machine is idle or in a fault */

void settings_reset(void);

/* Time until the contactor opens at rest without a good line: ARMED_IDLE_MS, or `wd` if that is longer. */
uint16_t armed_idle_ms(void);

/* True if these values may all be used together. */
bool settings_good(const int32_t candidate[SETTINGS]);

#endif
