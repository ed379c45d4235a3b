// SPDX-License-Identifier: GPL-3.0-or-later
// simrun: the scanner's firmware in a simulated ATmega328P, with the rig around it.
//
// simrun --firmware scan.elf --port LINK [--edges FILE] [--control SOCKET] [--eeprom FILE] [--speed 1] [--autoreset]
//        [--microsteps-per-turn 28800] [--start 500] [--home-width 40] [--bounce US] [--begin CYCLE] [--seed N]
#define _GNU_SOURCE
#include <getopt.h>
#include <inttypes.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "avr_eeprom.h"
#include "avr_extint.h"
#include "sim_elf.h"
#include "clock.h"
#include "control.h"
#include "edges.h"
#include "orders.h"
#include "processor.h"
#include "rig/line.h"
#include "rig/noise.h"
#include "rig/plant.h"

enum { FREQUENCY = 16000000, TICK = 800 /* cycles: 50 us */, QUANTUM = FREQUENCY / 2000, EEPROM = 1024 };

avr_t *avr;
static const char *firmware, *edges_path, *control_path, *eeprom_path;
static void (*core_reset)(avr_t *);
static bool was_reset;

static void on_signal(int signal) {
    (void)signal;
    orders.stop = 1;
}

static void only_errors(avr_t *core, const int level, const char *format, va_list arguments) {
    (void)core;
    if (level <= LOG_ERROR) vfprintf(stderr, format, arguments);
}

// simavr would sleep in real time whenever the processor does; pace() does that, and for busy code too.
static void no_sleep(avr_t *core, avr_cycle_count_t cycles) {
    (void)core;
    (void)cycles;
}

static avr_cycle_count_t on_tick(avr_t *core, avr_cycle_count_t when, void *param) {
    (void)core;
    (void)param;
    plant_tick();
    line_tick();
    return when + TICK;
}

// Resets come from outside and from the processor's own watchdog; both pass here, in the middle of simavr's work.
static void on_reset(avr_t *core) {
    clock_notice_reset();
    was_reset = true;
    if (core_reset) core_reset(core);
}

// Low-level interrupts are the reset state of INT0 and INT1; simavr then polls a low pin every cycle, 25 times slower.
static void do_not_poll_pins(void) {
    avr_extint_set_strict_lvl_trig(avr, 0, 0);
    avr_extint_set_strict_lvl_trig(avr, 1, 0);
}

static void after_reset(void) {
    do_not_poll_pins();
    was_reset = false;
    resets++;
    note("reset", orders.reset_wanted ? orders.reset_wanted : "watchdog");
    orders.reset_wanted = NULL;
    plant_after_reset();
    line_after_reset();
}

// The EEPROM is kept in a file, so that a rig that comes back is the same one.
static void eeprom_load(void) {
    uint8_t bytes[EEPROM];
    FILE *file = eeprom_path ? fopen(eeprom_path, "rb") : NULL;
    if (!file) return;
    size_t count = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    avr_eeprom_desc_t content = {.ee = bytes, .offset = 0, .size = (uint32_t)count};
    if (count) avr_ioctl(avr, AVR_IOCTL_EEPROM_SET, &content);
}

static void eeprom_keep(void) {
    static uint8_t kept[EEPROM];
    uint8_t bytes[EEPROM] = {0};
    avr_eeprom_desc_t content = {.ee = bytes, .offset = 0, .size = EEPROM};
    if (!eeprom_path) return;
    avr_ioctl(avr, AVR_IOCTL_EEPROM_GET, &content);
    if (!memcmp(bytes, kept, sizeof kept)) return;
    FILE *file = fopen(eeprom_path, "wb");
    if (!file) return;
    fwrite(bytes, 1, sizeof bytes, file);
    fclose(file);
    memcpy(kept, bytes, sizeof kept);
}

static bool parse(int argc, char **argv) {
    enum { FIRMWARE, PORT, EDGES, CONTROL, EEPROM_FILE, SPEED, AUTORESET, TURN, START, WIDTH, BOUNCE, BEGIN, SEED };
    static const struct option options[] = {
        {"firmware", 1, 0, FIRMWARE},   {"port", 1, 0, PORT},       {"edges", 1, 0, EDGES},
        {"control", 1, 0, CONTROL},     {"eeprom", 1, 0, EEPROM_FILE}, {"speed", 1, 0, SPEED},
        {"autoreset", 0, 0, AUTORESET}, {"microsteps-per-turn", 1, 0, TURN}, {"start", 1, 0, START},
        {"home-width", 1, 0, WIDTH},    {"bounce", 1, 0, BOUNCE},   {"begin", 1, 0, BEGIN},
        {"seed", 1, 0, SEED},           {0, 0, 0, 0}};
    for (int option; (option = getopt_long(argc, argv, "", options, NULL)) != -1;) switch (option) {
        case FIRMWARE: firmware = optarg; break;
        case PORT: orders.port_link = optarg; break;
        case EDGES: edges_path = optarg; break;
        case CONTROL: control_path = optarg; break;
        case EEPROM_FILE: eeprom_path = optarg; break;
        case SPEED: orders.speed = atof(optarg); break;
        case AUTORESET: orders.autoreset = true; break;
        case TURN: plant.microsteps_per_turn = atol(optarg); break;
        case START: plant.position = atol(optarg); break;
        case WIDTH: plant.home_width = atol(optarg); break;
        case BOUNCE: plant.bounce_us = (unsigned)atol(optarg); break;
        case BEGIN: clock_begin_at(strtoull(optarg, NULL, 10)); break;
        case SEED: noise_seed(strtoull(optarg, NULL, 10)); break;
        default: return false;
        }
    return firmware && orders.port_link && plant.microsteps_per_turn > 0;
}

static bool make_processor(void) {
    elf_firmware_t image;
    memset(&image, 0, sizeof image);
    avr_global_logger_set(only_errors);
    if (elf_read_firmware(firmware, &image)) return false;
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr) return false;
    avr_init(avr);
    image.frequency = FREQUENCY;
    avr_load_firmware(avr, &image);
    avr->frequency = FREQUENCY;
    avr->sleep = no_sleep;
    core_reset = avr->reset;
    avr->reset = on_reset;
    do_not_poll_pins();
    return true;
}

static int run(void) {
    int state = cpu_Running;
    avr_cycle_count_t next = 0, keep = 0;
    while (!orders.stop && state != cpu_Done && state != cpu_Crashed) {
        state = avr_run(avr);
        if (was_reset) {
            after_reset();
            next = keep = 0;
        }
        if (avr->cycle < next) continue;
        // A reset drops all of simavr's timers, this one too.
        if (!avr_cycle_timer_status(avr, on_tick, NULL)) avr_cycle_timer_register(avr, TICK, on_tick, NULL);
        control_poll();
        if (orders.reset_wanted) {
            avr_reset(avr);
            after_reset();
            state = cpu_Running;
            next = keep = 0;
            continue;
        }
        if (avr->cycle >= keep) {
            eeprom_keep();
            keep = avr->cycle + FREQUENCY / 200;
        }
        edges_flush();
        pace(orders.speed, FREQUENCY, line_wake_fd());
        next = avr->cycle + QUANTUM;
    }
    return state;
}

int main(int argc, char **argv) {
    prctl(PR_SET_PDEATHSIG, SIGTERM);  // never outlives who started it
    if (getppid() == 1 || !parse(argc, argv)) {
        fprintf(stderr, "simrun: needs --firmware ELF and --port LINK, see README.md\n");
        return 2;
    }
    if (!make_processor()) {
        fprintf(stderr, "simrun: %s cannot be loaded\n", firmware);
        return 1;
    }
    if (edges_path && !edges_open(edges_path, &plant.position)) return perror(edges_path), 1;
    eeprom_load();
    line_connect();
    plant_connect();
    if (!line_plug(orders.port_link)) return perror(orders.port_link), 1;
    if (control_path && !control_listen(control_path)) return perror(control_path), 1;
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
    printf("ready\n");
    fflush(stdout);
    int state = run();
    note("stop", state == cpu_Crashed ? "crashed" : state == cpu_Done ? "done" : "asked");
    eeprom_keep();
    edges_flush();
    line_unplug();
    edges_flush();
    control_close();
    return state == cpu_Crashed ? 3 : 0;
}
