/* Events: boot, ends of motions and shots, faults. It counts the boots.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef REPORT_H
#define REPORT_H

#include <stdbool.h>
#include <stdint.h>

void report_begin(uint8_t reset_cause); /* counts this boot and sends BOOT */
bool report_pending(void);              /* with interrupts off: whether a fault is to be sent */
void report_poll(void);                 /* main loop */

#endif
