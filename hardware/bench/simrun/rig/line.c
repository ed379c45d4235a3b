// SPDX-License-Identifier: GPL-3.0-or-later
// The serial line: USART0 on a pseudo-terminal. Bytes arrive no faster than the baud rate lets them; a firmware that does not
// fetch them in time loses them; nobody there is EIO on the master's side.
#define _GNU_SOURCE
#include "line.h"

#include <asm/termbits.h>
#include <errno.h>
#include <fcntl.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "avr_uart.h"
#include "edges.h"
#include "noise.h"
#include "orders.h"
#include "processor.h"

DEFINE_FIFO(uint16_t, uart_fifo);

// The part holds two bytes and has a third in its shifter; simavr's queue holds 64.
enum { HARDWARE_FIFO = 3 };
// Looking for bytes costs a system call: every so many ticks is often enough while none come.
enum { IDLE_TICKS = 4 };

struct line_counts line_counts;
static int master = -1;
static const char *link_path;
static bool host_present;
static uint8_t from_host[4096], to_host[8192];
static size_t from_next, from_end, to_count;
static avr_cycle_count_t next_byte;
static avr_uart_t *uart;
static avr_irq_t *input;

bool line_plug(const char *link) {
    if (master >= 0) return true;
    link_path = link;
    master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    char name[128];
    int unlock = 0;
    if (master < 0 || ioctl(master, TIOCSPTLCK, &unlock) || ptsname_r(master, name, sizeof name)) return false;
    // Opened and closed once: from now on the master reads EIO while nobody is there.
    int slave = open(name, O_RDWR | O_NOCTTY | O_CLOEXEC);
    if (slave < 0) return false;
    struct termios2 raw;
    ioctl(slave, TCGETS2, &raw);
    raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
    raw.c_cflag = (raw.c_cflag & ~(tcflag_t)(CSIZE | PARENB)) | CS8;
    ioctl(slave, TCSETS2, &raw);
    close(slave);
    unlink(link);
    note("line", "plugged");
    return symlink(name, link) == 0;
}

void line_unplug(void) {
    if (master < 0) return;
    unlink(link_path);
    close(master);
    master = -1;
    host_present = false;
    from_next = from_end = to_count = 0;
    note("line", "unplugged");
}

bool line_plugged(void) {
    return master >= 0;
}

bool line_host_present(void) {
    return host_present;
}

// Worth waking for only while it is empty: a full queue is emptied by simulated time alone.
int line_wake_fd(void) {
    return host_present && from_next == from_end ? master : -1;
}

static double firmware_baud(void) {
    if (!uart || !uart->cycles_per_byte) return 0;
    unsigned divider = (unsigned)avr->data[uart->ubrrl.reg] | (unsigned)(avr->data[uart->ubrrh.reg] & 0x0F) << 8;
    bool twice = avr->data[uart->r_ucsra] >> uart->u2x.bit & 1;
    return (double)avr->frequency / (twice ? 8 : 16) / (divider + 1);
}

// At another baud rate nothing sensible arrives, in either direction.
static bool rates_agree(void) {
    struct termios2 host;
    double ours = firmware_baud();
    if (!ours || ioctl(master, TCGETS2, &host)) return true;
    double ratio = host.c_ospeed / ours;
    return ratio > 0.97 && ratio < 1.03;
}

static void on_byte_out(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    (void)param;
    line_counts.sent++;
    uint8_t out[2];
    int count = noise_apply(TX, (uint8_t)value, out);
    for (int i = 0; i < count; i++) {
        if (host_present && to_count < sizeof to_host)
            to_host[to_count++] = out[i];
        else
            line_counts.unheard++;
    }
}

static void give_to_host(void) {
    if (!to_count) return;
    if (!rates_agree())
        for (size_t i = 0; i < to_count; i++)
            to_host[i] = (uint8_t)(to_host[i] * 2u ^ 0xF1u);
    ssize_t gone = write(master, to_host, to_count);
    if (gone > 0) {
        to_count -= (size_t)gone;
        memmove(to_host, to_host + gone, to_count);
    } else if (gone < 0 && errno == EIO) {
        line_counts.unheard += to_count;
        to_count = 0;
    }
}

static void take_from_host(void) {
    static int idle;
    if (from_next != from_end || idle++ % IDLE_TICKS) return;
    ssize_t got = read(master, from_host, sizeof from_host);
    bool present = !(got < 0 && errno == EIO);
    if (present != host_present) {
        host_present = present;
        note("host", present ? "open" : "closed");
        // An Uno resets when DTR falls, which is when the port is opened.
        if (present && orders.autoreset) orders.reset_wanted = "dtr";
    }
    from_next = 0;
    from_end = got > 0 ? (size_t)got : 0;
    if (!from_end) return;
    idle = 0;
    if (next_byte < avr->cycle) next_byte = avr->cycle;
    if (!rates_agree())
        for (size_t i = 0; i < from_end; i++)
            from_host[i] = (uint8_t)(from_host[i] * 2u ^ 0xF1u);
}

static void feed_processor(void) {
    while (from_next != from_end && next_byte <= avr->cycle) {
        uint8_t arrived[2];
        int count = noise_apply(RX, from_host[from_next++], arrived);
        line_counts.received++;
        for (int i = 0; i < count; i++) {
            if (uart_fifo_get_read_size(&uart->input) >= HARDWARE_FIFO)
                line_counts.overrun++;
            else
                avr_raise_irq(input, arrived[i]);
        }
        // simavr hands bytes on no faster than one per byte time: whoever is late once would never catch up within a line
        // that came at the same pace, as the part itself does at once. So a line has small gaps here.
        avr_cycle_count_t byte_time = uart->cycles_per_byte ? uart->cycles_per_byte : 640;
        next_byte += (avr_cycle_count_t)(count == 2 ? 2 : 1) * (byte_time + byte_time / 4);
    }
}

void line_tick(void) {
    if (master < 0) return;
    give_to_host();
    take_from_host();
    feed_processor();
}

void line_connect(void) {
    for (avr_io_t *io = avr->io_port; io && !uart; io = io->next)
        if (!strcmp(io->kind, "uart")) uart = (avr_uart_t *)io;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    // By default simavr prints the sent bytes, and sleeps whenever the firmware polls.
    flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte_out, NULL);
}

void line_after_reset(void) {
    next_byte = avr->cycle;
    from_next = from_end = to_count = 0;
}
