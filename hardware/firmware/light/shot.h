/* The shot sequencer: by the clock's tick, n ms are n ticks exactly.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SHOT_H
#define SHOT_H

#include <stdbool.h>
#include <stdint.h>

#include "state.h"

enum shot_kind { A_SHOT, AN_EXPOSURE, A_TEST };

extern volatile uint16_t exposures; /* since boot */
extern volatile uint8_t shot_kind;
extern volatile uint32_t shot_id;

/* With interrupts off. */
void shot_begin(const struct shot_order *order);
void expose_begin(uint16_t ms);
void test_begin(void);
void shot_cancel(void);
bool shot_tick(void); /* false where the camera was not ready in time: a fault */

bool shot_running(void);
bool shot_testing(void);

#endif
