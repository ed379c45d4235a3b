/* SPDX-License-Identifier: Apache-2.0 */
#include "settings.h"

#include "state.h"
#include "text.h"

const struct setting_row setting_rows[SETTINGS] PROGMEM = {
    [WD] = {"wd", 500, 100, 60000},
    [VMAX] = {"vmax", 4000, 50, 10000},
    [VST] = {"vst", 400, 20, 10000},
    [ACC] = {"acc", 8000, 100, 60000},
    [HV] = {"hv", 200, 20, 10000},
    [BACK] = {"back", 0, 0, 10000},
    [DIR_SENSE] = {"dir", 0, 0, 1},
    [SETTL] = {"settl", 50, 0, 10000},
    [LON] = {"lon", 20, 0, 10000},
    [LOFF] = {"loff", 20, 0, 10000},
    [EXP] = {"exp", 10, 1, 5000},
    [GAP] = {"gap", 5, 0, 10000},
    [RDY_WAIT] = {"rdy", 0, 0, 10000},
    [SMIN] = {"smin", INT32_MIN, INT32_MIN, INT32_MAX},
    [SMAX] = {"smax", INT32_MAX, INT32_MIN, INT32_MAX},
};

int32_t settings[SETTINGS];

void settings_reset(void) {
    for (uint8_t i = 0; i < SETTINGS; i++)
        memcpy_P(&settings[i], &setting_rows[i].preset, sizeof settings[i]);
}

uint16_t armed_idle_ms(void) {
    return settings[WD] > (int32_t)ARMED_IDLE_MS ? (uint16_t)settings[WD] : (uint16_t)ARMED_IDLE_MS;
}

bool settings_good(const int32_t candidate[SETTINGS]) {
    for (uint8_t i = 0; i < SETTINGS; i++) {
        struct setting_row row;
        memcpy_P(&row, &setting_rows[i], sizeof row);
        if (candidate[i] < row.lowest || candidate[i] > row.highest) return false;
    }
    return candidate[VST] <= candidate[VMAX] && candidate[SMIN] <= candidate[SMAX];
}
