// SPDX-License-Identifier: GPL-3.0-or-later
#include "plant.h"

#include <stddef.h>
#include <string.h>

#include "avr_ioport.h"
#include "clock.h"
#include "edges.h"
#include "noise.h"
#include "processor.h"

struct plant plant = {.position = 500, .microsteps_per_turn = 28800, .home_width = 40, .home_forced = -1};

struct output {
    const char *name;
    char port;
    int bit;
    int idle;  // level while the processor does not drive it: the board's pull-ups and pull-downs
    bool *drives;
    int last;
};
// The wiring is that of hardware/firmware/pins.h.
static bool enable_n;
static struct output outputs[] = {
    {"step", 'D', 2, 0, &plant.step, -1},    {"dir", 'D', 5, 0, &plant.dir, -1},
    {"en_n", 'B', 0, 1, &enable_n, -1},      {"laser", 'B', 3, 0, &plant.laser[0].gate, -1},
    {"trig", 'B', 4, 0, &plant.trigger, -1}, {"led", 'B', 5, 0, &plant.led, -1},
    {"contactor", 'D', 4, 0, &plant.contactor, -1},
    {"laser_2", 'B', 2, 0, &plant.laser[1].gate, -1},
};
enum { OUTPUTS = sizeof outputs / sizeof *outputs };

static int home_pin = -1, home_settled = -1;
static uint64_t bounce_until, bounce_next;
static uint64_t last_step;

void plant_set_pin(char port, int bit, int value) {
    // A driven pin wins over its pull-up; simavr has to be told so, or every write to the port raises it again.
    static uint8_t driven_mask['D' - 'A' + 1], driven_value['D' - 'A' + 1];
    uint8_t *mask = &driven_mask[port - 'A'], *level = &driven_value[port - 'A'];
    *mask |= (uint8_t)(1u << bit);
    *level = (uint8_t)((*level & ~(1u << bit)) | (unsigned)(value != 0) << bit);
    avr_ioport_external_t external = {.name = port, .mask = *mask, .value = *level};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port), &external);
    // A reset empties the register that is read, and leaves the wire as it was: say it again, even if it is no news.
    avr_irq_t *pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), bit);
    pin->flags |= IRQ_FLAG_INIT;
    avr_raise_irq(pin, (uint32_t)value);
}

static void set_home(int level) {
    if (level == home_pin) return;
    home_pin = level;
    plant_set_pin('B', 1, level);
    edge("home_n", level);
}

static void home_update(void) {
    long turn = plant.microsteps_per_turn;
    long at = ((plant.position % turn) + turn) % turn;
    bool closed = at == 0 || at > turn - plant.home_width;
    int level = plant.home_forced >= 0 ? plant.home_forced : !closed;
    if (level == home_settled) return;
    bool first = home_settled < 0;
    home_settled = level;
    if (plant.bounce_us && !first) bounce_until = clock_cycles() + (uint64_t)plant.bounce_us * avr->frequency / 1000000u;
    bounce_next = 0;
    set_home(level);
}

static void light_update(void) {
    static const char *const names[LASERS] = {"light", "light_2"};
    for (int i = 0; i < LASERS; i++) {
        struct laser *laser = &plant.laser[i];
        // A welded MOSFET conducts whatever its gate says; the contactor in series still cuts it.
        bool gate = laser->health == LASER_WELDED || laser->gate;
        bool light = gate && plant.contactor && laser->health != LASER_DEAD;
        if (light == laser->light) continue;
        laser->light = light;
        edge(names[i], light);
    }
}

void plant_update(void) {
    home_update();
    light_update();
}

static void step(void) {
    uint64_t now = clock_cycles();
    double rate = now > last_step ? (double)avr->frequency / (double)(now - last_step) : 0;
    last_step = now;
    if (enable_n) return;
    plant.steps++;
    if (plant.drop > 0 || plant.stalled || (plant.torque_limit > 0 && rate > plant.torque_limit)) {
        if (plant.drop > 0) plant.drop--;
        plant.lost_steps++;
        return;
    }
    plant.position += plant.dir ? -1 : 1;
    home_update();
}

static bool driven(const struct output *output) {
    avr_ioport_state_t state;
    avr_ioctl(avr, AVR_IOCTL_IOPORT_GETSTATE(output->port), &state);
    return state.ddr >> output->bit & 1;
}

static void set_output(struct output *output, int level) {
    if (level == output->last) return;
    output->last = level;
    *output->drives = level;
    if (output->drives == &plant.step && level) step();
    plant.enabled = !enable_n;
    edge(output->name, level);
    light_update();
}

static void on_pin(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    struct output *output = param;
    // A pull-up inside the chip does not win against the board's resistor.
    set_output(output, driven(output) ? (int)(value & 1) : output->idle);
}

static void on_direction(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    char port = (char)(intptr_t)param;
    avr_ioport_state_t state;
    avr_ioctl(avr, AVR_IOCTL_IOPORT_GETSTATE(port), &state);
    for (int i = 0; i < OUTPUTS; i++)
        if (outputs[i].port == port) {
            bool out = value >> outputs[i].bit & 1;
            set_output(&outputs[i], out ? state.port >> outputs[i].bit & 1 : outputs[i].idle);
        }
}

static void drive_inputs(void) {
    home_pin = home_settled = -1;
    bounce_until = 0;
    plant_set_pin('D', 3, plant.estop);  // normally closed to ground: high is pressed, or a broken wire
    plant_set_pin('C', 0, plant.ready);
    home_update();
}

void plant_connect(void) {
    for (int i = 0; i < OUTPUTS; i++) {
        avr_irq_t *pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(outputs[i].port), outputs[i].bit);
        avr_irq_register_notify(pin, on_pin, &outputs[i]);
    }
    for (const char *port = "BD"; *port; port++) {
        avr_irq_t *ddr = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(*port), IOPORT_IRQ_DIRECTION_ALL);
        avr_irq_register_notify(ddr, on_direction, (void *)(intptr_t)*port);
    }
    plant_after_reset();
    edge("estop", plant.estop);
}

void plant_after_reset(void) {
    // In reset every pin is an input; simavr does not say so.
    for (int i = 0; i < OUTPUTS; i++)
        set_output(&outputs[i], outputs[i].idle);
    drive_inputs();
    light_update();
}

void plant_tick(void) {
    if (!bounce_until) return;
    uint64_t now = clock_cycles();
    if (now >= bounce_until) {
        bounce_until = 0;
        set_home(home_settled);
    } else if (now >= bounce_next) {
        set_home(!home_pin);
        bounce_next = now + (uint64_t)((50 + 300 * noise_uniform()) * avr->frequency / 1e6);
    }
}
