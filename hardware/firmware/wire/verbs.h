/* The verbs: their keys, their conditions, and their actions.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef VERBS_H
#define VERBS_H

#include <stdbool.h>
#include <stdint.h>

#include "protocol.h"
#include "text.h"

#define PROTOCOL_NUMBER 1
#ifndef FIRMWARE_VERSION
#define FIRMWARE_VERSION "1.0.0" /* of the fake controller in tests; the Makefile sets that of an image */
#endif

enum { HELLO_VERB, NO_VERB = 255 };

/* The state of a session; defined in commands.c. */
struct session {
    struct text reply; /* the answer or event that is being written */
    uint16_t last_seq, event_number, damaged, repeated;
    bool begun, strict;
};
extern struct session session;

uint8_t verb_find(const struct word *name);

/* Checks all keys, then all conditions, then carries the verb out. Returns an error, OK = 0; adds fields to the reply. */
uint8_t verb_carry_out(uint8_t verb, struct words *words, uint16_t seq);

void verb_status(void); /* STAT's fields */

#endif
