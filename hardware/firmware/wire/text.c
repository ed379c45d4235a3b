/* SPDX-License-Identifier: Apache-2.0 */
#include "text.h"

void text_clear(struct text *text) {
    text->length = 0;
    text->full = false;
}

void text_char(struct text *text, char letter) {
    if (text->length < TEXT_SIZE - 1)
        text->line[text->length++] = letter;
    else
        text->full = true;
}

void text_words(struct text *text, const char *flash) {
    for (char letter; (letter = (char)pgm_read_byte(flash)) != 0; flash++)
        text_char(text, letter);
}

void text_unsigned(struct text *text, uint32_t number) {
    char digits[10];
    uint8_t count = 0;
    do {
        digits[count++] = (char)('0' + number % 10);
        number /= 10;
    } while (number);
    while (count)
        text_char(text, digits[--count]);
}

void text_signed(struct text *text, int32_t number) {
    if (number < 0) {
        text_char(text, '-');
        text_unsigned(text, 0u - (uint32_t)number); /* -2147483648 has no positive in 32 bits signed. */
    } else
        text_unsigned(text, (uint32_t)number);
}

void text_hex4(struct text *text, uint16_t number) {
    for (int8_t shift = 12; shift >= 0; shift -= 4) {
        uint8_t digit = (number >> shift) & 15;
        text_char(text, (char)(digit < 10 ? '0' + digit : 'A' - 10 + digit));
    }
}

static void key(struct text *text, const char *flash_key) {
    text_char(text, ' ');
    text_words(text, flash_key);
    text_char(text, '=');
}

void text_field(struct text *text, const char *flash_key, uint32_t number) {
    key(text, flash_key);
    text_unsigned(text, number);
}

void text_field_signed(struct text *text, const char *flash_key, int32_t number) {
    key(text, flash_key);
    text_signed(text, number);
}
