/* SPDX-License-Identifier: Apache-2.0 */
#include "fake.h"

#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "protocol.h"
#include "settings.h"

struct fake fake;
static uint16_t seq;
static struct shot_order order;
static enum { NO_WORK, MOVE_WORK, HOME_WORK, SHOT_WORK, EXPOSURE_WORK, TEST_WORK } work;

void machine_status(struct machine_status *status) {
    *status = fake.status;
}

void machine_counters(struct machine_counters *counters) {
    *counters = fake.counters;
}

uint16_t machine_boot(void) {
    return 17;
}

void machine_feed(void) {
    fake.link_ms = (uint32_t)settings[WD];
    fake.armed_ms = armed_idle_ms();
}

static uint8_t still_idle(void) {
    if (fake.status.state == FAULTED) return E_FAULT;
    return fake.status.state == IDLE ? OK : E_BUSY;
}

uint8_t machine_enable(bool on) {
    uint8_t refusal = still_idle();
    if (refusal) return refusal;
    fake.status.enabled = on;
    if (!on) fake.status.homed = false;
    return OK;
}

static void laser_off(void) {
    fake.status.laser = 0;
    fake.status.lease_ms = 0;
}

uint8_t machine_arm(bool on) {
    if (on) {
        uint8_t refusal = still_idle();
        if (refusal) return refusal;
    } else
        machine_laser_off();
    fake.status.armed = on;
    return OK;
}

uint8_t machine_laser_off(void) {
    laser_off();
    if (work == SHOT_WORK) machine_stop();
    return OK;
}

uint8_t machine_laser(uint8_t number, uint16_t ms) {
    if (fake.status.state == FAULTED) return E_FAULT;
    fake.laser_asked++;
    if (!fake.status.armed || !ms || ms > LEASE_MS || number < 1 || number > LASERS) abort(); /* commands.c must have refused it */
    if (fake.status.laser != number) fake.counters.laser++;
    fake.status.laser = number;
    fake.status.lease_ms = ms;
    return OK;
}

static uint8_t begin(uint16_t number, uint8_t state, int32_t to) {
    uint8_t refusal = still_idle();
    if (refusal) return refusal;
    fake.motions++;
    fake.status.state = state;
    seq = number;
    fake.shot_modes = 0;
    fake.target = to;
    return OK;
}

uint8_t machine_move(uint16_t number, int32_t to) {
    uint8_t refusal = begin(number, MOVING, to);
    if (!refusal) work = MOVE_WORK;
    return refusal;
}

uint8_t machine_home(uint16_t number, uint32_t most) {
    if (most == 0 || most > INT32_MAX) abort();
    uint8_t refusal = begin(number, HOMING, 0);
    if (refusal) return refusal;
    laser_off();
    fake.status.homed = false;
    work = HOME_WORK;
    return OK;
}

uint8_t machine_shot(uint16_t number, const struct shot_order *wanted) {
    if (wanted->modes < LIT || wanted->modes > (LIT | DARK) || wanted->id > INT32_MAX) abort();
    if (wanted->laser < 1 || wanted->laser > LASERS) abort();
    if ((wanted->modes & LIT) && !fake.status.armed) abort();
    uint8_t refusal = begin(number, SHOOTING, wanted->to);
    if (refusal) return refusal;
    laser_off();
    order = *wanted;
    fake.shot_modes = wanted->modes;
    work = SHOT_WORK;
    return OK;
}

uint8_t machine_expose(uint16_t number, uint16_t ms) {
    if (ms < 1 || ms > 5000) abort();
    uint8_t refusal = begin(number, SHOOTING, fake.status.position);
    if (!refusal) work = EXPOSURE_WORK;
    return refusal;
}

uint8_t machine_selftest(uint16_t number) {
    uint8_t refusal = begin(number, SHOOTING, fake.status.position);
    if (!refusal) work = TEST_WORK;
    return refusal;
}

uint8_t machine_set(const int32_t *candidate) {
    if (candidate[DIR_SENSE] != settings[DIR_SENSE]) fake.status.homed = false;
    memcpy(settings, candidate, sizeof settings);
    machine_feed();
    return OK;
}

uint8_t machine_clear(void) {
    if (fake.status.inputs & INPUT_ESTOP) return E_FAULT;
    if (fake.status.state == FAULTED) fake.status.state = IDLE;
    fake.status.fault = NO_FAULT;
    return OK;
}

void machine_stop(void) {
    laser_off();
    if (work == NO_WORK) return;
    work = MOVE_WORK;
    fake.target = fake.status.position;
    fake.status.state = MOVING;
}

void machine_session(void) {
    laser_off();
    fake.status.armed = false;
    if (fake.status.state == SHOOTING) machine_stop();
}

void machine_write(const char *bytes, uint8_t length) {
    if (fake.sent_length + length > sizeof fake.sent) abort();
    memcpy(fake.sent + fake.sent_length, bytes, length);
    fake.sent_length += length;
    fake.writes++;
}

static void say(const char *name, const char *first, uint32_t value, const char *second, int32_t value2, bool exposures) {
    struct event event = {name, first, second, exposures ? "trg" : NULL, value, value2, fake.status.exposures};
    commands_event(&event);
}

void fake_reset(void) {
    memset(&fake, 0, sizeof fake);
    work = NO_WORK;
    commands_reset();
    say("BOOT", "why", 2, "boot", 17, false);
}

void fake_fault(uint8_t which) {
    laser_off();
    fake.status.armed = false;
    work = NO_WORK;
    if (which == F_ESTOP) fake.status.enabled = fake.status.homed = false;
    fake.status.state = FAULTED;
    fake.status.fault = which;
    say("FAULT", "f", which, "pos", fake.status.position, false);
}

void fake_pass(uint32_t ms) {
    while (ms--) {
        if (fake.link_ms) fake.link_ms--;
        if (fake.armed_ms) fake.armed_ms--;
        if (fake.status.laser && !--fake.status.lease_ms) fake_fault(F_LEASE);
        bool runs = fake.status.laser || (fake.status.state != IDLE && fake.status.state != FAULTED);
        if (!fake.link_ms && runs) fake_fault(F_LINK);
        if (!fake.armed_ms && fake.status.state == IDLE) fake.status.armed = false;
    }
}

void fake_byte(uint8_t byte) {
    if (byte == ABORT_BYTE) fake_fault(F_ABORT);
    commands_byte(byte);
}

void fake_end(void) {
    uint8_t ended = work;
    if (work == NO_WORK) return;
    work = NO_WORK;
    fake.status.state = IDLE;
    if (ended == HOME_WORK) {
        int32_t was = fake.counters.home_was = fake.status.position;
        fake.status.position = 0;
        fake.status.homed = true;
        say("HOMED", "seq", seq, "was", was, false);
        return;
    }
    fake.status.position = fake.target;
    if (ended == MOVE_WORK) say("DONE", "seq", seq, "pos", fake.target, false);
    if (ended == EXPOSURE_WORK) fake.status.exposures++;
    if (ended == TEST_WORK) say("TESTED", "seq", seq, NULL, 0, false);
    if (ended != SHOT_WORK) return;
    if (fake.shot_modes & LIT) fake.counters.laser++, fake.lit_by_shots[order.laser - 1]++;
    fake.status.exposures = (uint16_t)(fake.status.exposures + (fake.shot_modes & LIT ? 1 : 0) + (fake.shot_modes & DARK ? 1 : 0));
    say("SHOT", "id", order.id, "pos", fake.target, true);
}
