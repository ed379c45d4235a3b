/* From bytes to commands, and answers and events back: lines, sessions, repeated sequence numbers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef COMMANDS_H
#define COMMANDS_H

#include <stdint.h>

void commands_reset(void);
void commands_byte(uint8_t byte);

/* Events: up to two fields, the names from flash, NULL for none. The first is unsigned, the second signed. */
struct event {
    const char *name, *first, *second, *third;
    uint32_t first_value;
    int32_t second_value;
    uint16_t third_value;
};
void commands_event(const struct event *event);

#endif
