/* Motions: absolute targets approached from below, homing on an edge.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef MOTION_H
#define MOTION_H

#include <stdbool.h>
#include <stdint.h>

/* With interrupts off; motion_poll continues the motion. */
void motion_begin_move(int32_t to);
void motion_begin_home(uint32_t most);
void motion_halt(void); /* no further step; forgets home if it ran faster than vst */
void motion_slow(void); /* down the ramp, then at rest */
void motion_forget(void); /* the table may have been turned by hand */
bool motion_busy(void);

void motion_poll(void); /* main loop: from one leg to the next */
int32_t motion_position(void);

enum home_outcome { HOME_STOPPED, HOME_MISSED, HOME_FOUND };
enum home_outcome motion_home_outcome(void); /* of the last homing, once it is not busy */
int32_t motion_home_was(void);

#endif
