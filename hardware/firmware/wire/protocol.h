/* The wire, JXS/1: bytes to lines, lines to checked messages, answers to bytes. No hardware; the host's tests compile it too.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include <stdbool.h>
#include <stdint.h>

#include "text.h"

#define LINE_MAX 96 /* bytes of a line, its newline not counted */
#define WORD_MAX 8  /* letters of the longest verb */
#define ABORT_BYTE 0x1B /* Esc: differs in at least two bits from every byte of a line */

enum error {
    OK = 0,
    E_SYNTAX = 1,
    E_DAMAGED = 2,
    E_VERB = 3,
    E_ARGUMENT = 4,
    E_BUSY = 5,
    E_FAULT = 6,
    E_NOT_HOMED = 8,
    E_SESSION = 9,
    E_LONG = 10,
    E_DISABLED = 11,
    E_LIMIT = 13,
    E_NOT_ARMED = 14
};

/* Line assembly */
enum arrival { NOTHING, LINE, TOO_LONG, QUESTION };
struct assembler {
    char line[LINE_MAX];
    uint8_t length;
    bool long_line;
};
/* Takes one byte. After LINE the line is in line[0 .. length); its reader sets length to 0. */
enum arrival assemble(struct assembler *assembler, uint8_t byte);

uint16_t crc16(const char *bytes, uint8_t length);

/* The frame around a line's words */
enum frame_kind {
    FRAME_CHECKED, /* a correct CRC */
    FRAME_BARE,    /* no CRC, no sequence number: typed by a person */
    FRAME_DAMAGED, /* possibly a damaged line */
    FRAME_BROKEN   /* a correct CRC, but no valid sequence number */
};
struct frame {
    uint16_t seq; /* 0: none */
    const char *words;
    uint8_t length;
};
enum frame_kind open_frame(const char *line, uint8_t length, struct frame *frame);

/* The words: VERB[ key=int]... A cursor that takes them one by one. */
struct words {
    const char *at, *end;
};
struct word {
    const char *start;
    uint8_t length;
};
bool take_verb(struct words *words, struct word *verb);

enum taken { TAKEN, TAKEN_ALL, TAKEN_BROKEN, TAKEN_OVERFLOW };
/* The next " key=int"; TAKEN_ALL at the end, TAKEN_BROKEN for another form, TAKEN_OVERFLOW beyond 32 bits signed. */
enum taken take_pair(struct words *words, struct word *key, int32_t *value);

bool same_word(const struct word *word, const char *flash, uint8_t size);

/* Answers: each begins a text, fields may follow, text_end adds the CRC and completes it. */
void begin_ok(struct text *text, uint16_t seq);
void begin_error(struct text *text, uint16_t seq, enum error error);
void begin_unquoted(struct text *text, enum error error); /* =? err: no sequence number can be trusted */
void begin_event(struct text *text, uint16_t number, const char *flash_name);
void text_end(struct text *text); /* "*CRC\n"; leaves the text empty if it did not fit */

#endif
