/* Takes bytes on standard input as the serial line, answers on standard output; for tests from any language.
 *
 * Bytes go to the firmware as they are, except for lines that begin with a NUL byte, which speak to the fake machine:
 *   \0boot   a fresh boot        \0end        the running action ends       \0fault N    fault N comes
 *   \0input N  inputs as in STAT  \0pos N      position                 \0extreme    every number of the machine at its longest
 *   \0pass N   N ms pass without input
 *   \0mark   writes a line with one NUL, so that the reader knows that everything before it was answered
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fake.h"

static void flush(void) {
    if (fwrite(fake.sent, 1, fake.sent_length, stdout) != fake.sent_length) exit(1);
    fake.sent_length = 0;
}

static void extreme(void) {
    fake.status.position = INT32_MIN;
    fake.status.homed = fake.status.armed = fake.status.enabled = true;
    fake.status.laser = LASERS;
    fake.status.lease_ms = fake.status.exposures = UINT16_MAX;
    fake.status.inputs = 7;
    fake.counters.home_was = INT32_MIN;
    fake.counters.laser = fake.counters.up_ms = UINT32_MAX;
    fake.counters.lost_bytes = fake.counters.watchdog_resets = UINT16_MAX;
}

static void control(const char *order) {
    long number = strchr(order, ' ') ? strtol(strchr(order, ' ') + 1, NULL, 10) : 0;
    if (!strcmp(order, "boot"))
        fake_reset();
    else if (!strcmp(order, "end"))
        fake_end();
    else if (!strncmp(order, "fault ", 6))
        fake_fault((uint8_t)number);
    else if (!strncmp(order, "input ", 6))
        fake.status.inputs = (uint8_t)number;
    else if (!strncmp(order, "pos ", 4))
        fake.status.position = (int32_t)number;
    else if (!strncmp(order, "pass ", 5))
        fake_pass((uint32_t)number);
    else if (!strcmp(order, "extreme"))
        extreme();
    else if (!strcmp(order, "mark")) {
        flush();
        fwrite("\0\n", 1, 2, stdout);
        fflush(stdout);
    } else
        exit(2);
}

int main(void) {
    char order[64];
    size_t length = 0;
    int in_order = 0;
    fake_reset();
    flush();
    for (int byte; (byte = getchar()) != EOF;) {
        if (!in_order && byte == 0) {
            in_order = 1;
            length = 0;
        } else if (in_order && byte == '\n') {
            order[length] = 0;
            in_order = 0;
            control(order);
        } else if (in_order) {
            if (length + 1 >= sizeof order) return 2;
            order[length++] = (char)byte;
        } else
            fake_byte((uint8_t)byte);
        flush();
    }
    return 0;
}
