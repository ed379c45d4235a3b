/* The scanner's controller. Its protocol is in ../PROTOCOL.md, its wiring in README.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <avr/interrupt.h>
#include <avr/sleep.h>

#include "commands.h"
#include "motion.h"
#include "report.h"
#include "uart.h"
#include "watch.h"

static void sleep_until_something_happens(void) {
    cli();
    if (uart_waiting() || report_pending()) {
        sei();
        return;
    }
    sleep_enable();
    sei(); /* The next instruction runs before any interrupt, so that none is missed in sleep. */
    sleep_cpu();
    sleep_disable();
}

int main(void) {
    uint8_t reset_cause = watch_begin();
    commands_reset();
    uart_begin();
    watch_start_clock();
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();
    report_begin(reset_cause);
    for (;;) {
        watch_loop_lives();
        motion_poll();
        report_poll();
        int16_t byte = uart_take();
        if (byte >= 0)
            commands_byte((uint8_t)byte);
        else
            sleep_until_something_happens();
    }
}
