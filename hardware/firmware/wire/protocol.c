/* SPDX-License-Identifier: Apache-2.0 */
#include "protocol.h"

enum arrival assemble(struct assembler *assembler, uint8_t byte) {
    switch (byte) {
    case '\r':
        return NOTHING;
    case ABORT_BYTE: /* The interrupt has handled it already; the line before it is discarded. */
        assembler->length = 0;
        assembler->long_line = false;
        return NOTHING;
    case '\n': {
        bool long_line = assembler->long_line, any = assembler->length != 0;
        assembler->long_line = false;
        if (long_line) {
            assembler->length = 0;
            return TOO_LONG;
        }
        return any ? LINE : NOTHING;
    }
    case '?':
        if (!assembler->length && !assembler->long_line) return QUESTION;
        break;
    default:
        break;
    }
    if (assembler->length < LINE_MAX)
        assembler->line[assembler->length++] = (char)byte;
    else
        assembler->long_line = true;
    return NOTHING;
}

uint16_t crc16(const char *bytes, uint8_t length) {
    uint16_t crc = 0xFFFF;
    while (length--) { /* a byte at a time, without a table: the polynomial 0x1021 written out */
        crc = (uint16_t)(crc >> 8 | crc << 8);
        crc ^= (uint8_t)*bytes++;
        crc ^= (uint8_t)(crc & 0xFF) >> 4;
        crc ^= (uint16_t)(crc << 12);
        crc ^= (uint16_t)((crc & 0xFF) << 5);
    }
    return crc;
}

static bool digit(char letter) {
    return letter >= '0' && letter <= '9';
}

static bool hex4(const char *letters, uint16_t *number) {
    *number = 0;
    for (uint8_t i = 0; i < 4; i++) {
        char letter = letters[i];
        uint8_t nibble;
        if (digit(letter))
            nibble = (uint8_t)(letter - '0');
        else if (letter >= 'A' && letter <= 'F')
            nibble = (uint8_t)(letter - 'A' + 10);
        else
            return false;
        *number = (uint16_t)(*number << 4 | nibble);
    }
    return true;
}

/* Digits without leading zeros up to `highest`: the number of digits, 0 for none or another form. */
static uint8_t take_number(const char *at, const char *end, uint32_t highest, uint32_t *number, bool *overflow) {
    uint8_t count = 0;
    *number = 0;
    *overflow = false;
    while (at + count < end && digit(at[count])) {
        uint8_t unit = (uint8_t)(at[count] - '0');
        if (*number > (highest - unit) / 10) *overflow = true;
        if (!*overflow) *number = *number * 10 + unit;
        count++;
    }
    return count > 1 && at[0] == '0' ? 0 : count;
}

enum frame_kind open_frame(const char *line, uint8_t length, struct frame *frame) {
    uint8_t star = 0;
    while (star < length && line[star] != '*')
        star++;
    frame->seq = 0;
    frame->words = line;
    frame->length = length;
    if (star == length) return line[0] == '@' ? FRAME_DAMAGED : FRAME_BARE; /* A lost star must not change the meaning. */
    uint16_t crc;
    if (length - star != 5 || !hex4(line + star + 1, &crc) || crc != crc16(line, star)) return FRAME_DAMAGED;
    frame->length = star;
    if (star == 0 || line[0] != '@') return FRAME_CHECKED;
    uint32_t seq;
    bool overflow;
    uint8_t digits = take_number(line + 1, line + star, 65535, &seq, &overflow);
    if (!digits || overflow || seq == 0 || line[1 + digits] != ' ') return FRAME_BROKEN;
    frame->seq = (uint16_t)seq;
    frame->words = line + digits + 2;
    frame->length = (uint8_t)(star - digits - 2);
    return FRAME_CHECKED;
}

static uint8_t letters(const char *at, const char *end, char first, char last) {
    uint8_t count = 0;
    while (at + count < end && at[count] >= first && at[count] <= last)
        count++;
    return count;
}

bool take_verb(struct words *words, struct word *verb) {
    verb->start = words->at;
    verb->length = letters(words->at, words->end, 'A', 'Z');
    words->at += verb->length;
    return verb->length && (words->at == words->end || *words->at == ' ');
}

enum taken take_pair(struct words *words, struct word *key, int32_t *value) {
    const char *at = words->at, *end = words->end;
    if (at == end) return TAKEN_ALL;
    if (*at++ != ' ') return TAKEN_BROKEN;
    key->start = at;
    key->length = letters(at, end, 'a', 'z');
    at += key->length;
    if (!key->length || at == end || *at++ != '=') return TAKEN_BROKEN;
    bool minus = at < end && *at == '-', overflow;
    if (minus) at++;
    uint32_t number;
    uint8_t digits = take_number(at, end, minus ? 2147483648u : 2147483647u, &number, &overflow);
    at += digits;
    if (!digits || (minus && !overflow && number == 0) || (at < end && *at != ' ')) return TAKEN_BROKEN;
    words->at = at;
    if (overflow) return TAKEN_OVERFLOW;
    *value = minus ? (int32_t)(0u - number) : (int32_t)number;
    return TAKEN;
}

bool same_word(const struct word *word, const char *flash, uint8_t size) {
    if (word->length > size) return false;
    for (uint8_t i = 0; i < word->length; i++)
        if ((char)pgm_read_byte(flash + i) != word->start[i]) return false;
    return word->length == size || pgm_read_byte(flash + word->length) == 0;
}

void begin_ok(struct text *text, uint16_t seq) {
    text_clear(text);
    text_char(text, '=');
    text_unsigned(text, seq);
    text_words(text, PSTR(" ok"));
}

void begin_error(struct text *text, uint16_t seq, enum error error) {
    text_clear(text);
    text_char(text, '=');
    text_unsigned(text, seq);
    text_words(text, PSTR(" err "));
    text_unsigned(text, error);
}

void begin_unquoted(struct text *text, enum error error) {
    text_clear(text);
    text_words(text, PSTR("=? err "));
    text_unsigned(text, error);
}

void begin_event(struct text *text, uint16_t number, const char *flash_name) {
    text_clear(text);
    text_char(text, '!');
    text_unsigned(text, number);
    text_char(text, ' ');
    text_words(text, flash_name);
}

void text_end(struct text *text) {
    uint16_t crc = crc16(text->line, text->length);
    text_char(text, '*');
    text_hex4(text, crc);
    text_char(text, '\n');
    if (text->full) text_clear(text);
}
