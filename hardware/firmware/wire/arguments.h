/* The keys of a command's line and their values.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef ARGUMENTS_H
#define ARGUMENTS_H

#include <stdbool.h>
#include <stdint.h>

#include "protocol.h"
#include "settings.h"

/* The settings by their own numbers, then these. */
enum key { SES = SETTINGS, ON, MS, TO, MOST, ID, MODES, SHOT_PART, HANG_KIND, NUMBER, KEYS };
#define BIT(key) ((uint32_t)1 << (key))
#define ALL_SETTINGS (BIT(SETTINGS) - 1)

struct arguments {
    uint32_t present;
    int32_t value[KEYS];
};

/* Reads the rest of a line; refuses keys that are not in `allowed`, and lines that lack a key of `required`. */
uint8_t take_arguments(struct words *words, uint32_t required, uint32_t allowed, struct arguments *arguments);

bool given(const struct arguments *arguments, uint8_t key);
bool within(const struct arguments *arguments, uint8_t key, int32_t lowest, int32_t highest);

#endif
