/* Feeds many lines to the firmware's portable half - valid, damaged, and noise - and stops at the first violation.
 *
 *   fuzz LINES [SEED]
 *
 * It counts the commands that it sent with a correct CRC, and compares them with the actions of the fake machine. Sanitizers check
 * the memory meanwhile.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fake.h"
#include "protocol.h"
#include "settings.h"

static uint64_t random_state;
static unsigned long lines, answers, refused, lit, moved;
static char line[256];
static int line_length;

static void must(bool holds, const char *what) {
    if (holds) return;
    fprintf(stderr, "line %lu: %s\n  said:     %.*s\n  answered: %.*s\n", lines, what, line_length, line, (int)fake.sent_length,
            fake.sent);
    exit(1);
}

static uint32_t any(uint32_t below) { /* xorshift64*: the same lines for the same seed, everywhere */
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (uint32_t)((random_state * 2685821657736338717ull) >> 33) % below;
}

/* An independent CRC, bit by bit. */
static unsigned crc_bitwise(const char *bytes, int length) {
    unsigned crc = 0xFFFF;
    for (int i = 0; i < length; i++)
        for (int bit = 7; bit >= 0; bit--) {
            unsigned in = ((unsigned char)bytes[i] >> bit) & 1, top = crc >> 15 & 1;
            crc = (crc << 1 & 0xFFFF) ^ (in ^ top ? 0x1021 : 0);
        }
    return crc;
}

static long some_number(void) {
    static const long edges[] = {0, 1, -1, 2, 3, 7, 100, 1000, 1001, 5000, 60000, 65535, 65536, 2147483647, -2147483647 - 1};
    switch (any(4)) {
    case 0:
        return edges[any(sizeof edges / sizeof *edges)];
    case 1:
        return (long)any(1u << 30) - (1l << 29);
    default:
        return (long)any(2000);
    }
}

static void build_words(char *words, size_t size) {
    static const char *const verbs[] = {"HELLO", "STAT", "CNT", "CFG", "SET", "PING", "EN", "ARM", "LASER", "MOVE",
                                        "HOME", "SHOT", "TRIG", "STOP", "CLEAR", "SELFTEST", "HAS", "HANG", "stat", "X", ""};
    static const char *const keys[] = {"ses", "on", "ms", "to", "max", "id", "m", "n", "shot", "k", "wd", "vmax", "vst", "acc", "hv",
                                       "back", "dir", "settl", "lon", "loff", "exp", "gap", "rdy", "smin", "smax", "zz", ""};
    static const char *const likely[] = {"EN on=1", "ARM on=1", "HOME max=30000", "SET wd=500 vmax=4000", "CLEAR", "STAT",
                                         "LASER on=1 ms=%u", "MOVE to=%u", "SHOT to=%u id=7", "HELLO ses=5", "ARM on=0",
                                         "CFG shot=1", "CLEAR", "ARM on=1", "LASER on=1 ms=%u", "LASER on=1 ms=%u",
                                         "SET smin=-100 smax=1900", "SHOT to=%u id=2 m=3", "SET smin=-100 smax=1500", "LASER on=0", "SHOT to=%u id=1 m=2",
                                         "LASER on=1 ms=%u n=2", "SHOT to=%u id=3 n=2", "LASER on=1 ms=%u n=3", "SHOT to=%u id=4 m=1 n=2"};
    if (any(3)) {
        snprintf(words, size, likely[any(sizeof likely / sizeof *likely)], (unsigned)any(2000));
        return;
    }
    int at = snprintf(words, size, "%s", verbs[any(sizeof verbs / sizeof *verbs)]);
    for (unsigned count = any(4); count-- && at < (int)size - 40;)
        at += snprintf(words + at, size - (size_t)at, " %s=%ld", keys[any(sizeof keys / sizeof *keys)], some_number());
}

static void finish(char *framed, size_t size, const char *words, bool good_crc) {
    int at = any(12) ? snprintf(framed, size, "@%u %s", 1 + any(65535), words) : snprintf(framed, size, "%s", words);
    unsigned crc = crc_bitwise(framed, at);
    if (!good_crc) crc ^= 1 + any(0xFFFF);
    snprintf(framed + at, size - (size_t)at, "*%04X", crc & 0xFFFF);
}

static void damage(void) {
    for (unsigned times = 1 + any(3); times-- && line_length > 0;) {
        int where = (int)any((uint32_t)line_length);
        switch (any(3)) {
        case 0:
            line[where] = (char)(line[where] ^ (1 << any(8)));
            break;
        case 1: /* lost */
            memmove(line + where, line + where + 1, (size_t)(line_length - where - 1));
            line_length--;
            break;
        default: /* doubled */
            if (line_length >= 200) break;
            memmove(line + where + 1, line + where, (size_t)(line_length - where));
            line_length++;
            break;
        }
    }
}

static void build_line(void) {
    char words[160];
    build_words(words, 120);
    unsigned kind = any(10);
    if (kind == 9) { /* noise */
        line_length = (int)any(200);
        for (int i = 0; i < line_length; i++)
            line[i] = (char)any(256);
        return;
    }
    finish(line, sizeof line, words, kind != 8);
    line_length = (int)strlen(line);
    if (kind == 7) damage();
    if (kind == 6) { /* too long, or just not */
        char padded[240] = "";
        snprintf(padded, sizeof padded, "@5 STAT%*s", (int)(70 + any(60)), "x=1");
        line_length = snprintf(line, sizeof line, "%s*%04X", padded, crc_bitwise(padded, (int)strlen(padded)));
    }
    if (kind == 5) line_length = snprintf(line, sizeof line, "%s", words); /* a person's */
}

static void drop_returns(void) { /* Damage may put in a byte that the firmware ignores. */
    int kept = 0;
    for (int i = 0; i < line_length; i++)
        if (line[i] != '\r') line[kept++] = line[i];
    line_length = kept;
}

/* Judged by its final bytes, since damage may cancel out. */
static bool is_checked_line(void) {
    if (line_length < 6 || line_length > LINE_MAX || memchr(line, '*', (size_t)line_length) != line + line_length - 5)
        return false;
    char crc[5];
    snprintf(crc, sizeof crc, "%04X", crc_bitwise(line, line_length - 5));
    return !memcmp(crc, line + line_length - 4, 4);
}

static void check_answers(void) {
    size_t at = 0;
    while (at < fake.sent_length) {
        char *start = fake.sent + at, *end = memchr(start, '\n', fake.sent_length - at);
        must(end != NULL, "an answer without an end");
        int length = (int)(end - start);
        must(length + 1 <= 127, "an answer longer than 127 bytes");
        must(length > 5 && start[length - 5] == '*', "an answer without a CRC");
        char crc[5];
        snprintf(crc, sizeof crc, "%04X", crc_bitwise(start, length - 5));
        must(!memcmp(crc, start + length - 4, 4), "an answer with a wrong CRC");
        for (int i = 0; i < length; i++)
            must(start[i] >= ' ' && start[i] <= '~', "an answer with unprintable bytes");
        must(start[0] == '=' || start[0] == '!', "an answer of unknown kind");
        answers++;
        refused += strstr(start, " err ") && strstr(start, " err ") < end;
        at = (size_t)(end + 1 - fake.sent);
    }
}

static bool line_says(const char *words) {
    char text[257];
    memcpy(text, line, (size_t)line_length);
    text[line_length] = 0;
    return (size_t)line_length == strlen(text) && strstr(text, words) != NULL;
}

/* Noise holds newlines and abort bytes, and can switch only off; a bare line counts only while the link is not strict. */
static void check_machine(const struct fake *before, bool authorised, bool strict) {
    const struct machine_status *now = &fake.status;
    bool hello = line_length >= 5 && !memcmp(line, "HELLO", 5); /* A person may always take over. */
    bool bare = line_length <= LINE_MAX && line[0] != '@'; /* A number needs a CRC, always. */
    bool may = authorised || ((!strict || hello) && bare);
    if (fake.laser_asked != before->laser_asked) {
        lit++;
        must(may && line_says("LASER on=1 "), "the laser was switched on and nobody asked for it");
        must(before->status.armed && before->status.state != FAULTED, "the laser was switched on and may not be");
        must(now->laser == (line_says(" n=2") ? 2 : 1), "another laser than the one that was asked for");
        must(now->lease_ms >= 1 && now->lease_ms <= LEASE_MS, "the lease is out of range");
    }
    if (now->armed && !before->status.armed) must(may && line_says("ARM on=1"), "armed, and nobody asked for it");
    if (fake.motions != before->motions) {
        moved++;
        must(may, "a motion that nobody asked for");
        must(before->status.state == IDLE, "a motion began while it was not idle");
        bool bound = before->status.homed && (fake.status.state == MOVING || fake.shot_modes);
        must(!bound || (fake.target >= settings[SMIN] && fake.target <= settings[SMAX]), "a motion beyond the limits");
        must(fake.status.state != SHOOTING || fake.shot_modes == 0 || before->status.homed, "a shot from an unknown place");
    }
    must(now->laser <= LASERS, "a laser that is not there");
    must(!now->laser || now->armed, "the laser is on and not armed");
    must(!now->armed || fake.armed_ms, "armed, and nobody is there");
    must(now->state != FAULTED || (!now->laser && !now->armed && now->fault), "a fault that did not make safe");
    must(settings_good(settings), "settings that no SET may leave");
    if (memcmp(now, &before->status, sizeof *now)) must(may || memchr(line, ABORT_BYTE, (size_t)line_length), "a damaged line changed something");
}

static void play(bool *strict) {
    struct fake before = fake;
    build_line();
    for (int i = 0; i < line_length; i++)
        fake_byte((uint8_t)line[i]);
    fake_byte('\n');
    drop_returns();
    bool authorised = is_checked_line();
    check_answers();
    check_machine(&before, authorised, *strict);
    bool greeted = fake.sent_length && strstr(fake.sent, " ok proto=1");
    must(!greeted || !fake.status.armed, "armed before the session that greets");
    if (greeted) *strict = memchr(line, '*', (size_t)line_length) != NULL;
    fake.sent_length = 0;
    memset(fake.sent, 0, sizeof fake.sent);
    if (any(2)) fake_end();
    if (!any(400)) fake_fault((uint8_t)(1 + any(6)));
    if (!any(100)) fake_pass(any(12000));
    must(!fake.status.armed || fake.armed_ms || fake.status.state != IDLE, "armed, at rest, and nobody is there");
    check_answers();
    fake.sent_length = 0;
    memset(fake.sent, 0, sizeof fake.sent);
}

int main(int argc, char **argv) {
    unsigned long wanted = argc > 1 ? strtoul(argv[1], NULL, 10) : 100000;
    random_state = 0x9E3779B97F4A7C15ull ^ (argc > 2 ? strtoull(argv[2], NULL, 10) : 1);
    bool strict = false;
    fake_reset();
    fake.sent_length = 0;
    for (lines = 1; lines <= wanted; lines++) {
        play(&strict);
        if (lines % 5000 == 0) {
            fake_reset();
            fake.sent_length = 0;
            strict = false;
        }
    }
    printf("%lu lines, %lu answers, %lu refusals, %lu times laser on, %lu motions\n", wanted, answers, refused, lit, moved);
    return answers && lit && moved ? 0 : 1;
}
