/* From bytes to what the machine does, and back: session, verbs, who may do what and when.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef COMMANDS_H
#define COMMANDS_H

#include <stdint.h>

#define PROTOCOL_NUMBER 1
#define FIRMWARE_VERSION "1.0.0"

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
