/* SPDX-License-Identifier: Apache-2.0 */
#include "arguments.h"

static const char key_names[KEYS - SETTINGS][4] PROGMEM = {"ses", "on", "ms", "to", "max", "id", "m", "shot", "k", "n"};

bool given(const struct arguments *arguments, uint8_t key) {
    return arguments->present & BIT(key);
}

bool within(const struct arguments *arguments, uint8_t key, int32_t lowest, int32_t highest) {
    return arguments->value[key] >= lowest && arguments->value[key] <= highest;
}

static uint8_t find_key(const struct word *name) {
    for (uint8_t i = 0; i < SETTINGS; i++)
        if (same_word(name, setting_rows[i].name, sizeof setting_rows[i].name)) return i;
    for (uint8_t i = SETTINGS; i < KEYS; i++)
        if (same_word(name, key_names[i - SETTINGS], sizeof key_names[0])) return i;
    return KEYS;
}

uint8_t take_arguments(struct words *words, uint32_t required, uint32_t allowed, struct arguments *arguments) {
    struct word name;
    enum taken taken;
    uint8_t refusal = OK;
    int32_t value = 0;
    arguments->present = 0;
    while ((taken = take_pair(words, &name, &value)) != TAKEN_ALL) {
        if (taken == TAKEN_BROKEN) return E_SYNTAX;
        uint8_t key = find_key(&name);
        if (taken == TAKEN_OVERFLOW || key == KEYS || !(allowed & BIT(key)) || given(arguments, key))
            refusal = E_ARGUMENT; /* Read on: a syntax error takes precedence. */
        else {
            arguments->present |= BIT(key);
            arguments->value[key] = value;
        }
    }
    if ((arguments->present & required) != required) refusal = E_ARGUMENT;
    return refusal;
}
