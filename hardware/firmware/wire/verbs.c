/* SPDX-License-Identifier: Apache-2.0 */
#include "verbs.h"

#include "arguments.h"
#include "machine.h"
#include "protocol.h"
#include "settings.h"

/* Conditions of a verb; checked in this order. */
enum need {
    NO_FAULT_NOW = 1,
    A_SESSION = 2,
    AT_REST = 4,       /* idle */
    AT_REST_OR_MOVING = 8,
    AT_REST_OR_FAULT = 16,
    ENABLED = 32,
    HOMED = 64,
    ARMED = 128
};

static uint8_t permitted(uint8_t needs) {
    struct machine_status status;
    machine_status(&status);
    if ((needs & NO_FAULT_NOW) && status.state == FAULTED) return E_FAULT;
    if ((needs & A_SESSION) && !session.begun) return E_SESSION;
    if ((needs & AT_REST) && status.state != IDLE) return E_BUSY;
    if ((needs & AT_REST_OR_MOVING) && status.state != IDLE && status.state != MOVING) return E_BUSY;
    if ((needs & AT_REST_OR_FAULT) && status.state != IDLE && status.state != FAULTED) return E_BUSY;
    if ((needs & ENABLED) && !status.enabled) return E_DISABLED;
    if ((needs & HOMED) && !status.homed) return E_NOT_HOMED;
    if ((needs & ARMED) && !status.armed) return E_NOT_ARMED;
    return OK;
}

static bool beyond_limits(int32_t to) {
    struct machine_status status;
    machine_status(&status);
    if (to < INT32_MIN + settings[BACK]) return true; /* The approach would begin below the lowest number. */
    return status.homed && (to < settings[SMIN] || to > settings[SMAX]);
}

/* Verbs: each returns why it is refused, or is carried out and adds its fields to the reply. */

static uint8_t hello(const struct arguments *arguments, uint16_t seq) {
    (void)seq;
    if (!within(arguments, SES, 1, INT32_MAX)) return E_ARGUMENT;
    session.begun = true;
    session.event_number = 0;
    machine_session();
    text_field(&session.reply, PSTR("proto"), PROTOCOL_NUMBER);
    text_words(&session.reply, PSTR(" fw=" FIRMWARE_VERSION));
    text_field(&session.reply, PSTR("boot"), machine_boot());
    text_field(&session.reply, PSTR("lease"), LEASE_MS);
    text_field(&session.reply, PSTR("buf"), LINE_MAX);
    return OK;
}

static uint8_t stat(const struct arguments *arguments, uint16_t seq) {
    (void)arguments;
    (void)seq;
    static const char names[][6] PROGMEM = {"idle", "move", "home", "shot", "fault"};
    struct machine_status status;
    machine_status(&status);
    text_words(&session.reply, PSTR(" st="));
    text_words(&session.reply, names[status.state]);
    text_field(&session.reply, PSTR("f"), status.fault);
    text_field_signed(&session.reply, PSTR("pos"), status.position);
    text_field(&session.reply, PSTR("hm"), status.homed);
    text_field(&session.reply, PSTR("arm"), status.armed);
    text_field(&session.reply, PSTR("en"), status.enabled);
    text_field(&session.reply, PSTR("las"), status.laser);
    text_field(&session.reply, PSTR("le"), status.lease_ms);
    text_field(&session.reply, PSTR("trg"), status.exposures);
    text_field(&session.reply, PSTR("in"), status.inputs);
    text_field(&session.reply, PSTR("ev"), session.event_number);
    return OK;
}

static uint8_t counts(const struct arguments *arguments, uint16_t seq) {
    (void)arguments;
    (void)seq;
    struct machine_counters counters;
    machine_counters(&counters);
    text_field(&session.reply, PSTR("crc"), session.damaged);
    text_field(&session.reply, PSTR("over"), counters.lost_bytes);
    text_field(&session.reply, PSTR("dup"), session.repeated);
    text_field(&session.reply, PSTR("las"), counters.laser);
    text_field(&session.reply, PSTR("up"), counters.up_ms);
    text_field(&session.reply, PSTR("wdr"), counters.watchdog_resets);
    text_field_signed(&session.reply, PSTR("was"), counters.home_was);
    return OK;
}

static uint8_t abilities(const struct arguments *arguments, uint16_t seq) {
    (void)arguments;
    (void)seq;
    text_field(&session.reply, PSTR("las"), LASERS);
    return OK;
}

static uint8_t configuration(const struct arguments *arguments, uint16_t seq) {
    (void)seq;
    bool of_shots = given(arguments, SHOT_PART) && arguments->value[SHOT_PART] != 0;
    if (given(arguments, SHOT_PART) && !within(arguments, SHOT_PART, 0, 1)) return E_ARGUMENT;
    uint8_t first = of_shots ? SHOT_SETTINGS : 0, end = of_shots ? SETTINGS : SHOT_SETTINGS;
    for (uint8_t i = first; i < end; i++)
        text_field_signed(&session.reply, setting_rows[i].name, settings[i]);
    return OK;
}

static uint8_t set(const struct arguments *arguments, uint16_t seq) {
    (void)seq;
    if (!arguments->present) return E_ARGUMENT;
    int32_t candidate[SETTINGS];
    for (uint8_t i = 0; i < SETTINGS; i++)
        candidate[i] = given(arguments, i) ? arguments->value[i] : settings[i];
    return settings_good(candidate) ? machine_set(candidate) : (uint8_t)E_ARGUMENT;
}

static uint8_t ping(const struct arguments *arguments, uint16_t seq) {
    (void)arguments;
    (void)seq;
    return OK; /* Every good line feeds the link watchdog. */
}

static uint8_t enable(const struct arguments *arguments, uint16_t seq) {
    (void)seq;
    return within(arguments, ON, 0, 1) ? machine_enable(arguments->value[ON] != 0) : (uint8_t)E_ARGUMENT;
}

static uint8_t arm(const struct arguments *arguments, uint16_t seq) {
    (void)seq;
    if (!within(arguments, ON, 0, 1)) return E_ARGUMENT;
    if (!arguments->value[ON]) return machine_arm(false);
    uint8_t refusal = permitted(NO_FAULT_NOW | A_SESSION | AT_REST);
    return refusal ? refusal : machine_arm(true);
}

/* The number of the laser: 1 if none is given, 0 for one that does not exist. */
static uint8_t laser_number(const struct arguments *arguments) {
    if (!given(arguments, NUMBER)) return 1;
    return within(arguments, NUMBER, 1, LASERS) ? (uint8_t)arguments->value[NUMBER] : 0;
}

static uint8_t laser(const struct arguments *arguments, uint16_t seq) {
    (void)seq;
    if (!within(arguments, ON, 0, 1)) return E_ARGUMENT;
    if (!arguments->value[ON]) return machine_laser_off();
    uint8_t number = laser_number(arguments);
    if (!number || !given(arguments, MS) || !within(arguments, MS, 1, LEASE_MS)) return E_ARGUMENT;
    uint8_t refusal = permitted(NO_FAULT_NOW | A_SESSION | AT_REST_OR_MOVING | ARMED);
    return refusal ? refusal : machine_laser(number, (uint16_t)arguments->value[MS]);
}

static uint8_t move(const struct arguments *arguments, uint16_t seq) {
    if (beyond_limits(arguments->value[TO])) return E_LIMIT;
    return machine_move(seq, arguments->value[TO]);
}

static uint8_t home(const struct arguments *arguments, uint16_t seq) {
    if (arguments->value[MOST] < 1) return E_ARGUMENT;
    uint8_t refusal = permitted(NO_FAULT_NOW | A_SESSION | AT_REST | ENABLED);
    return refusal ? refusal : machine_home(seq, (uint32_t)arguments->value[MOST]);
}

static uint8_t shot(const struct arguments *arguments, uint16_t seq) {
    uint8_t modes = LIT | DARK;
    if (given(arguments, MODES)) {
        if (!within(arguments, MODES, LIT, LIT | DARK)) return E_ARGUMENT;
        modes = (uint8_t)arguments->value[MODES];
    }
    uint8_t number = laser_number(arguments);
    if (!number || arguments->value[ID] < 0) return E_ARGUMENT;
    uint8_t needs = NO_FAULT_NOW | A_SESSION | AT_REST | ENABLED | HOMED;
    uint8_t refusal = permitted(modes & LIT ? needs | ARMED : needs);
    if (refusal) return refusal;
    if (beyond_limits(arguments->value[TO])) return E_LIMIT;
    struct shot_order order = {arguments->value[TO], (uint32_t)arguments->value[ID], modes, number};
    return machine_shot(seq, &order);
}

static uint8_t expose(const struct arguments *arguments, uint16_t seq) {
    int32_t ms = given(arguments, MS) ? arguments->value[MS] : settings[EXP];
    if (ms < 1 || ms > 5000) return E_ARGUMENT;
    uint8_t refusal = permitted(NO_FAULT_NOW | A_SESSION | AT_REST);
    return refusal ? refusal : machine_expose(seq, (uint16_t)ms);
}

static uint8_t stop(const struct arguments *arguments, uint16_t seq) {
    (void)arguments;
    (void)seq;
    machine_stop();
    return OK;
}

static uint8_t clear(const struct arguments *arguments, uint16_t seq) {
    (void)arguments;
    (void)seq;
    return machine_clear();
}

static uint8_t selftest(const struct arguments *arguments, uint16_t seq) {
    (void)arguments;
    struct machine_status status;
    machine_status(&status);
    return status.armed ? (uint8_t)E_BUSY : machine_selftest(seq);
}

#ifdef TEST_HANG
static uint8_t hang(const struct arguments *arguments, uint16_t seq) {
    (void)seq;
    machine_hang(arguments->value[HANG_KIND] != 0);
    return OK;
}
#endif

struct verb {
    char name[WORD_MAX];
    uint8_t needs;
    uint32_t required, allowed;
    uint8_t (*act)(const struct arguments *arguments, uint16_t seq);
};

/* Conditions that depend on the arguments are checked by the verb itself. HELLO is the first. */
static const struct verb verbs[] PROGMEM = {
    {"HELLO", 0, BIT(SES), BIT(SES), hello},
    {"STAT", 0, 0, 0, stat},
    {"CNT", 0, 0, 0, counts},
    {"HAS", 0, 0, 0, abilities},
    {"CFG", 0, 0, BIT(SHOT_PART), configuration},
    {"SET", AT_REST_OR_FAULT, 0, ALL_SETTINGS, set},
    {"PING", 0, 0, 0, ping},
    {"EN", NO_FAULT_NOW | AT_REST, BIT(ON), BIT(ON), enable},
    {"ARM", 0, BIT(ON), BIT(ON), arm},
    {"LASER", 0, BIT(ON), BIT(ON) | BIT(MS) | BIT(NUMBER), laser},
    {"MOVE", NO_FAULT_NOW | A_SESSION | AT_REST | ENABLED, BIT(TO), BIT(TO), move},
    {"HOME", 0, BIT(MOST), BIT(MOST), home},
    {"SHOT", 0, BIT(TO) | BIT(ID), BIT(TO) | BIT(ID) | BIT(MODES) | BIT(NUMBER), shot},
    {"TRIG", 0, 0, BIT(MS), expose},
    {"STOP", 0, 0, 0, stop},
    {"CLEAR", 0, 0, 0, clear},
    {"SELFTEST", NO_FAULT_NOW | A_SESSION | AT_REST, 0, 0, selftest},
#ifdef TEST_HANG
    {"HANG", 0, BIT(HANG_KIND), BIT(HANG_KIND), hang},
#endif
};
#define VERBS (sizeof verbs / sizeof *verbs)

uint8_t verb_find(const struct word *name) {
    for (uint8_t i = 0; i < VERBS; i++)
        if (same_word(name, verbs[i].name, WORD_MAX)) return i;
    return NO_VERB;
}

uint8_t verb_carry_out(uint8_t which, struct words *words, uint16_t seq) {
    struct verb verb;
    struct arguments arguments;
    memcpy_P(&verb, &verbs[which], sizeof verb);
    uint8_t refusal = take_arguments(words, verb.required, verb.allowed, &arguments);
    if (!refusal) refusal = permitted(verb.needs);
    return refusal ? refusal : verb.act(&arguments, seq);
}

void verb_status(void) {
    stat(0, 0);
}
