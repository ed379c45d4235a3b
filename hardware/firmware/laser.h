/* The laser's gate with its lease, and the contactor in its supply. All with interrupts off.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LASER_H
#define LASER_H

#include <stdbool.h>
#include <stdint.h>

extern volatile uint32_t laser_switched; /* times it was switched on */
extern volatile uint16_t laser_lease_ms;

void laser_on(uint16_t lease_ms); /* on; again: renews the lease. Only with the contactor closed. */
void laser_off(void);
bool laser_is_on(void);
void laser_count_down(void); /* each ms, before the shot's tick */
bool laser_expired(void);    /* each ms, after it: on, and the lease is over */

void contactor_close(void);
void contactor_open(void);
bool contactor_closed(void);

#endif
