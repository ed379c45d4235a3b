/* Builds text that never overruns its buffer, from words in flash if there is flash.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TEXT_H
#define TEXT_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __AVR__
#include <avr/pgmspace.h>
#else /* a host's program has one kind of memory */
#include <string.h>
#define PROGMEM
#define PSTR(words) (words)
#define pgm_read_byte(where) (*(const uint8_t *)(where))
#define memcpy_P memcpy
#endif

#define TEXT_SIZE 128 /* No reply and no event is longer than 127. */

struct text {
    char line[TEXT_SIZE];
    uint8_t length;
    bool full; /* The text did not fit and must not be sent. */
};

void text_clear(struct text *text);
void text_char(struct text *text, char letter);
void text_words(struct text *text, const char *flash);
void text_unsigned(struct text *text, uint32_t number);
void text_signed(struct text *text, int32_t number);
void text_hex4(struct text *text, uint16_t number);

/* " key=number" with the key from flash */
void text_field(struct text *text, const char *flash_key, uint32_t number);
void text_field_signed(struct text *text, const char *flash_key, int32_t number);

#endif
