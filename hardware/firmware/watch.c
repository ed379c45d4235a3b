/* SPDX-License-Identifier: Apache-2.0 */
#include "watch.h"

#include <avr/interrupt.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "laser.h"
#include "motion.h"
#include "pins.h"
#include "shot.h"

static volatile uint16_t link_ms; /* until the link counts as lost */
static volatile uint16_t armed_ms; /* until the contactor opens at rest */
static volatile bool ticked;

/* Optiboot clears MCUSR and leaves it in r2; both are read before anything else can run. */
static uint8_t reset_cause __attribute__((section(".noinit")));
void reset_begin(void) __attribute__((naked, used, section(".init3")));
void reset_begin(void) {
    uint8_t from_bootloader;
    __asm__ volatile("mov %0, r2" : "=r"(from_bootloader));
    reset_cause = MCUSR ? MCUSR : from_bootloader & 0x0F;
    MCUSR = 0;
    wdt_enable(WDTO_250MS); /* It stays on after a reset that it caused, with its shortest time. */
}

uint8_t watch_begin(void) {
    PORTB = EN_N | HOME_N; /* levels before directions, so that lasers and trigger are never driven high */
    PORTD = ESTOP;
    PORTC = 0;
    DDRB = EN_N | LASERS_ALL | TRIG | LED;
    DDRD = STEP | DIR | CONTACTOR;
    DDRC = 0;
    EICRA = _BV(ISC11) | _BV(ISC10); /* e-stop: rising edge */
    EIFR = _BV(INTF1);
    EIMSK = _BV(INT1);
    if (estop_pressed()) fault_enter(F_ESTOP);
    return reset_cause;
}

void watch_start_clock(void) {
    TCCR0A = _BV(WGM01);
    OCR0A = F_CPU / 64 / 1000 - 1; /* 1 ms */
    TIMSK0 = _BV(OCIE0A);
    TCCR0B = _BV(CS01) | _BV(CS00);
}

void watch_loop_lives(void) {
    if (!ticked) return; /* Clock and loop must both live. */
    ticked = false;
    wdt_reset();
}

void watch_feed(uint16_t ms, uint16_t idle_ms) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        link_ms = ms;
        armed_ms = idle_ms;
    }
}

void driver_switch(bool on) {
    if (on)
        PORTB &= (uint8_t)~EN_N;
    else
        PORTB |= EN_N;
    enabled = on;
    if (!on) {
        homed = false;
        motion_forget();
    }
}

void fault_enter(enum fault which) {
    laser_off();
    contactor_open();
    shot_cancel();
    motion_halt();
    if (which == F_ESTOP) driver_switch(false);
    if (state == FAULTED && (fault == F_ESTOP || (which != F_ESTOP && which != F_ABORT))) return;
    state = FAULTED;
    fault = which;
    fault_unsaid = true;
}

ISR(INT1_vect) {
    fault_enter(F_ESTOP);
}

static void show(void) {
    if (shot_testing()) return;
    if (contactor_closed() || (state == FAULTED && ((uint8_t)clock_ms & 128)))
        PORTB |= LED;
    else
        PORTB &= (uint8_t)~LED;
}

ISR(TIMER0_COMPA_vect) {
    clock_ms++;
    ticked = true;
    if (link_ms) link_ms--;
    if (armed_ms) armed_ms--;
    laser_count_down();
    if (estop_pressed() && fault != F_ESTOP) fault_enter(F_ESTOP);
    if (!shot_tick()) fault_enter(F_CAMERA);
    if (laser_expired()) fault_enter(F_LEASE);
    if (!link_ms && (laser_lit() || (state != IDLE && state != FAULTED))) fault_enter(F_LINK);
    if (!armed_ms && state == IDLE) contactor_open(); /* A MOSFET may have failed closed. */
    show();
}
