/* SPDX-License-Identifier: Apache-2.0 */
#include "commands.h"

#include <string.h>

#include "machine.h"
#include "protocol.h"
#include "settings.h"
#include "verbs.h"

struct session session;
static struct assembler assembler;
static struct text last_reply;

static void send(struct text *text) {
    text_end(text);
    machine_write(text->line, text->length);
}

static void refuse_unquoted(enum error error) {
    begin_unquoted(&session.reply, error);
    send(&session.reply);
}

static void take_line(const char *line, uint8_t length) {
    struct frame frame;
    enum frame_kind kind = open_frame(line, length, &frame);
    struct words words = {frame.words, frame.words + frame.length};
    struct word name;
    bool formed = kind != FRAME_BROKEN && take_verb(&words, &name);
    uint8_t verb = formed ? verb_find(&name) : NO_VERB;
    bool is_hello = verb == HELLO_VERB;
    if (kind == FRAME_DAMAGED || (kind == FRAME_BARE && session.strict && !is_hello)) {
        session.damaged++;
        refuse_unquoted(E_DAMAGED);
        return;
    }
    if (kind != FRAME_BARE || !session.strict) machine_feed();
    if (frame.seq && frame.seq == session.last_seq && !is_hello) {
        session.repeated++;
        machine_write(last_reply.line, last_reply.length);
        return;
    }
    begin_ok(&session.reply, frame.seq);
    uint8_t refusal = !formed ? E_SYNTAX : verb == NO_VERB ? E_VERB : verb_carry_out(verb, &words, frame.seq);
    if (refusal) begin_error(&session.reply, frame.seq, refusal);
    if (is_hello && !refusal) session.strict = kind == FRAME_CHECKED;
    send(&session.reply);
    if (frame.seq) {
        session.last_seq = frame.seq;
        last_reply = session.reply;
    }
}

void commands_reset(void) {
    memset(&assembler, 0, sizeof assembler);
    memset(&session, 0, sizeof session);
    settings_reset();
}

void commands_byte(uint8_t byte) {
    switch (assemble(&assembler, byte)) {
    case LINE:
        take_line(assembler.line, assembler.length);
        assembler.length = 0;
        break;
    case TOO_LONG:
        refuse_unquoted(E_LONG);
        break;
    case QUESTION:
        if (!session.strict) machine_feed(); /* A single byte without a CRC counts only while the link is not strict. */
        begin_ok(&session.reply, 0);
        verb_status();
        send(&session.reply);
        break;
    default:
        break;
    }
}

void commands_event(const struct event *event) {
    session.event_number = session.event_number == UINT16_MAX ? 1 : (uint16_t)(session.event_number + 1);
    begin_event(&session.reply, session.event_number, event->name);
    text_field(&session.reply, event->first, event->first_value);
    if (event->second) text_field_signed(&session.reply, event->second, event->second_value);
    if (event->third) text_field(&session.reply, event->third, event->third_value);
    send(&session.reply);
}
