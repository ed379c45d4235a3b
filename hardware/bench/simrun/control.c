// SPDX-License-Identifier: GPL-3.0-or-later
// The control socket: one line in, one line out. Commands for switches, cables, faults and tests.
#define _GNU_SOURCE
#include "control.h"

#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "clock.h"
#include "edges.h"
#include "orders.h"
#include "processor.h"
#include "rig/line.h"
#include "rig/noise.h"
#include "rig/plant.h"

enum { CLIENTS = 8, LINE = 256 };

struct client {
    int fd;
    size_t count;
    char text[LINE];
};
static struct client clients[CLIENTS];
static int listener = -1;
static const char *socket_path;

bool control_listen(const char *path) {
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    if (strlen(path) >= sizeof address.sun_path) return false;
    strcpy(address.sun_path, path);
    unlink(path);
    socket_path = path;
    for (int i = 0; i < CLIENTS; i++)
        clients[i].fd = -1;
    listener = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    return listener >= 0 && !bind(listener, (struct sockaddr *)&address, sizeof address) && !listen(listener, CLIENTS);
}

static void state(char *out, size_t size) {
    static const char *const health[] = {"good", "welded", "dead"};
    snprintf(out, size,
             "{\"cycle\":%" PRIu64 ",\"pos\":%ld,\"laser\":%d,\"laser_2\":%d,\"contactor\":%d,\"light\":%d,\"light_2\":%d,\"trig\":%d,\"enabled\":%d,"
             "\"dir\":%d,\"led\":%d,\"estop\":%d,\"ready\":%d,\"laser_health\":\"%s\",\"laser_2_health\":\"%s\",\"steps\":%" PRIu64
             ",\"lost_steps\":%" PRIu64 ",\"resets\":%" PRIu64 ",\"received\":%" PRIu64 ",\"sent\":%" PRIu64
             ",\"lost\":%" PRIu64 ",\"unheard\":%" PRIu64 ",\"plugged\":%d,\"host\":%d,\"speed\":%g,\"processor\":%d}\n",
             clock_cycles(), plant.position, plant.laser[0].gate, plant.laser[1].gate, plant.contactor, plant.laser[0].light,
             plant.laser[1].light, plant.trigger, plant.enabled,
             plant.dir, plant.led, plant.estop, plant.ready, health[plant.laser[0].health],
             health[plant.laser[1].health], plant.steps, plant.lost_steps,
             resets, line_counts.received, line_counts.sent, line_counts.overrun, line_counts.unheard, line_plugged(),
             line_host_present(), orders.speed, avr->state);
}

static bool set_probability(const char *name, double value) {
    if (value < 0 || value > 1) return false;
    for (int way = RX; way <= TX; way++) {
        const char *end = way == RX ? "_rx" : "_tx";
        const char *underscore = strrchr(name, '_');
        if (!underscore || strcmp(underscore, end)) continue;
        size_t length = (size_t)(underscore - name);
        if (!strncmp(name, "corrupt", length)) return noise[way].corrupt = value, true;
        if (!strncmp(name, "drop", length)) return noise[way].drop = value, true;
        if (!strncmp(name, "duplicate", length)) return noise[way].duplicate = value, true;
    }
    return false;
}

static bool set_laser(const char *name, const char *word) {
    struct laser *laser = !strcmp(name, "laser") ? &plant.laser[0] : !strcmp(name, "laser_2") ? &plant.laser[1] : NULL;
    if (!laser) return false;
    if (!strcmp(word, "good"))
        laser->health = LASER_GOOD;
    else if (!strcmp(word, "welded"))
        laser->health = LASER_WELDED;
    else if (!strcmp(word, "dead"))
        laser->health = LASER_DEAD;
    else
        return false;
    plant_update();
    return true;
}

// A command with a number; false if there is no such command or the number is out of range.
static bool command_number(const char *verb, double number) {
    long whole = (long)number;
    if (strchr(verb, '_')) return set_probability(verb, number);
    if (!strcmp(verb, "estop")) {
        plant.estop = whole;
        plant_set_pin('D', 3, plant.estop);
        edge("estop", plant.estop);
    } else if (!strcmp(verb, "ready")) {
        plant.ready = whole != 0;
        plant_set_pin('C', 0, plant.ready);
        edge("ready", plant.ready);
    } else if (!strcmp(verb, "speed")) {
        if (number < 0) return false;
        orders.speed = number;
    } else if (!strcmp(verb, "home")) {
        plant.home_forced = whole < 0 ? -1 : whole != 0;
        plant_update();
    } else if (!strcmp(verb, "bounce")) {
        plant.bounce_us = whole > 0 ? (unsigned)whole : 0;
    } else if (!strcmp(verb, "drop")) {
        plant.drop = whole;
    } else if (!strcmp(verb, "stall")) {
        plant.stalled = whole != 0;
    } else if (!strcmp(verb, "torque")) {
        plant.torque_limit = number;
    } else if (!strcmp(verb, "pos")) {
        plant.position = whole;
        plant_update();
    } else if (!strcmp(verb, "seed")) {
        noise_seed((uint64_t)number);
    } else {
        return false;
    }
    return true;
}

static bool command_word(const char *verb) {
    if (!strcmp(verb, "reset"))
        orders.reset_wanted = "button";
    else if (!strcmp(verb, "unplug"))
        line_unplug();
    else if (!strcmp(verb, "plug"))
        return line_plug(orders.port_link);
    else if (!strcmp(verb, "quit"))
        orders.stop = 1;
    else
        return false;
    return true;
}

static void carry_out(struct client *client) {
    char out[1024] = "ok\n", verb[32] = "", word[32] = "", port = 0;
    double number;
    int bit, level;
    if (sscanf(client->text, "pin %c%d %d", &port, &bit, &level) == 3 && port >= 'B' && port <= 'D' && bit >= 0 && bit < 8)
        plant_set_pin(port, bit, level != 0);
    else if (!strcmp(client->text, "state"))
        state(out, sizeof out);
    else if (sscanf(client->text, "%31s %lf", verb, &number) == 2 ? !command_number(verb, number)
             : sscanf(client->text, "%31s %31s", verb, word) == 2 ? !set_laser(verb, word)
                                                                  : !command_word(verb))
        snprintf(out, sizeof out, "unknown: %.200s\n", client->text);
    // Who has an answer finds everything before it in the log.
    edges_flush();
    // The answer fits the socket's buffer; a client that has gone is found by the next read.
    if (write(client->fd, out, strlen(out)) < 0) client->count = 0;
}

static void hear(struct client *client) {
    ssize_t got = read(client->fd, client->text + client->count, LINE - 1 - client->count);
    if (got == 0) {
        close(client->fd);
        client->fd = -1;
    }
    if (got <= 0) return;
    client->count += (size_t)got;
    client->text[client->count] = 0;
    for (char *end; client->fd >= 0 && (end = memchr(client->text, '\n', client->count));) {
        *end = 0;
        carry_out(client);
        size_t used = (size_t)(end + 1 - client->text);
        client->count = client->count > used ? client->count - used : 0;
        memmove(client->text, end + 1, client->count);
    }
    if (client->count == LINE - 1) client->count = 0;
}

static void welcome(void) {
    int fd = accept4(listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
    for (int i = 0; fd >= 0 && i < CLIENTS; i++)
        if (clients[i].fd < 0) {
            clients[i] = (struct client){.fd = fd};
            return;
        }
    if (fd >= 0) close(fd);  // too many: that one sees the end of the conversation
}

void control_poll(void) {
    if (listener < 0) return;
    struct pollfd ready[CLIENTS + 1];
    for (int i = 0; i < CLIENTS; i++)
        ready[i] = (struct pollfd){.fd = clients[i].fd, .events = POLLIN};
    ready[CLIENTS] = (struct pollfd){.fd = listener, .events = POLLIN};
    if (poll(ready, CLIENTS + 1, 0) <= 0) return;
    for (int i = 0; i < CLIENTS; i++)
        if (ready[i].fd >= 0 && ready[i].revents) hear(&clients[i]);
    if (ready[CLIENTS].revents) welcome();
}

void control_close(void) {
    if (listener >= 0) unlink(socket_path);
}
