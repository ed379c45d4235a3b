/* The lasers' gates with their lease, and the contactor in their supply. One laser at most is lit. All with interrupts off.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LASER_H
#define LASER_H

#include <stdbool.h>
#include <stdint.h>

extern volatile uint32_t laser_switched; /* times one was switched on */
extern volatile uint16_t laser_lease_ms;

void laser_on(uint8_t number, uint16_t lease_ms); /* this one alone; again: renews the lease. Only with the contactor closed. */
void laser_off(void);                             /* all of them */
uint8_t laser_lit(void);                          /* the number of the one that is lit, 0 for none */
void laser_count_down(void); /* each ms, before the shot's tick */
bool laser_expired(void);    /* each ms, after it: on, and the lease is over */

void contactor_close(void);
void contactor_open(void);
bool contactor_closed(void);

#endif
