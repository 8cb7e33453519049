/* Runs the controller in lockstep with the bench, which starts this program. */
#include <stdio.h>
#include <string.h>

#include "controller.h"
#include "lockstep.h"

#define NS_PER_S 1e9
#define PATH_MAX_LENGTH 64
#define NAME_MAX_LENGTH 64U
#define KEY_MAX_LENGTH 96U
#define NS_PER_MS 1000000
#define START_BOUND_M 0.5
#define UNKNOWN_BOUND_M 1e6
#define PI 3.14159265358979323846

static char report_key[KEY_MAX_LENGTH];
static char status_key[KEY_MAX_LENGTH];
static double report_ms;
static int64_t report_ns; /* Instant of the next position report and status. */

/* A number of a table of the line, such as "told/line/stations/2/stop_m". */
static bool of_table(const char *hello, const char *table, uint32_t at, const char *key,
                     double *value)
{
    char path[PATH_MAX_LENGTH];
    (void)snprintf(path, sizeof path, "told/%s/%u/%s", table, (unsigned int)at, key);
    return lockstep_number(hello, path, value);
}

/* Find a station by its name. */
static bool read_station(const char *hello, const char *name, struct stop *stop)
{
    char path[PATH_MAX_LENGTH];
    char text[NAME_MAX_LENGTH];
    bool found = false;
    bool more = true;
    for (uint32_t at = 0U; more && !found; at++) {
        (void)snprintf(path, sizeof path, "told/line/stations/%u/name", (unsigned int)at);
        more = lockstep_text(hello, path, text, sizeof text);
        if (more && (strcmp(text, name) == 0)) {
            found = of_table(hello, "line/stations", at, "stop_m", &stop->at_m) &&
                    of_table(hello, "line/stations", at, "dwell_s", &stop->dwell_s);
            (void)snprintf(path, sizeof path, "told/line/stations/%u/side", (unsigned int)at);
            stop->left = lockstep_text(hello, path, text, sizeof text) &&
                         (strcmp(text, "left") == 0);
        }
    }
    return found;
}

static bool read_mission(const char *hello, struct settings *settings)
{
    char path[PATH_MAX_LENGTH];
    char name[NAME_MAX_LENGTH];
    struct stop start;
    bool good = lockstep_text(hello, "told/mission/start", name, sizeof name) &&
                read_station(hello, name, &start);
    bool more = good;
    settings->start_m = good ? start.at_m : 0.0;
    settings->start_bound_m = START_BOUND_M;
    /* After a restart the bench says what is known of the place; mostly that it is unknown. */
    if (lockstep_number(hello, "told/standing/front_m", &settings->start_m)) {
        settings->start_bound_m = UNKNOWN_BOUND_M;
        (void)lockstep_number(hello, "told/standing/bound_m", &settings->start_bound_m);
    }
    while (more && (settings->stop_count < STOPS_MAX)) {
        (void)snprintf(path, sizeof path, "told/mission/stops/%u",
                       (unsigned int)settings->stop_count);
        more = lockstep_text(hello, path, name, sizeof name) &&
               read_station(hello, name, &settings->stops[settings->stop_count]);
        settings->stop_count += more ? 1U : 0U;
    }
    return good && (settings->stop_count > 0U);
}

static void read_line(const char *hello, struct settings *settings)
{
    bool more = true;
    while (more && (settings->section_count < SECTIONS_MAX)) {
        const uint32_t at = settings->section_count;
        struct section *section = &settings->sections[at];
        more = of_table(hello, "line/speed_sections", at, "start_m", &section->start_m) &&
               of_table(hello, "line/speed_sections", at, "end_m", &section->end_m) &&
               of_table(hello, "line/speed_sections", at, "limit_mps", &section->limit_mps);
        settings->section_count += more ? 1U : 0U;
    }
    more = true;
    while (more && (settings->tag_count < TAGS_MAX)) {
        const uint32_t at = settings->tag_count;
        double id = 0.0;
        more = of_table(hello, "line/tags", at, "tag_id", &id) &&
               of_table(hello, "line/tags", at, "position_m", &settings->tags[at].position_m);
        settings->tags[at].id = (uint32_t)id;
        settings->tag_count += more ? 1U : 0U;
    }
}

static bool read_train(const char *hello, struct settings *settings)
{
    double wheel_m = 0.0;
    double pulses = 1.0;
    double tare_kg = 0.0;
    double load_kg = 0.0;
    double rotating = 0.0;
    double cycle_ms = 0.0;
    const bool good = lockstep_number(hello, "told/params/cycle_ms", &cycle_ms) &&
                      lockstep_number(hello, "told/params/train/length_m", &settings->length_m) &&
                      lockstep_number(hello, "told/params/train/wheel_diameter_m", &wheel_m) &&
                      lockstep_number(hello, "told/params/train/pulses_per_turn", &pulses) &&
                      lockstep_number(hello, "told/params/train/tare_kg", &tare_kg) &&
                      lockstep_number(hello, "told/params/train/full_load_kg", &load_kg) &&
                      lockstep_number(hello, "told/params/train/rotating_mass_ratio", &rotating) &&
                      lockstep_number(hello, "told/params/train/antenna_offset_m",
                                      &settings->antenna_m);
    settings->cycle_s = cycle_ms / 1000.0;
    settings->m_per_pulse = (PI * wheel_m) / pulses;
    settings->mass_kg = (tare_kg * (1.0 + rotating)) + (0.5 * load_kg);
    return good;
}

static uint8_t digit_of(char letter)
{
    return (uint8_t)((letter <= '9') ? (letter - '0') : ((letter - 'a') + 10));
}

/* Versions and key are hexadecimal. */
static bool read_radio(const char *hello, struct radio *radio)
{
    char key[(2U * RADIO_KEY_MAX) + 1U];
    char database[17];
    char parameters[17];
    double train = 0.0;
    double boots = 0.0;
    const bool good =
        lockstep_text(hello, "told/radio/safety_key", key, sizeof key) &&
        lockstep_text(hello, "told/radio/database", database, sizeof database) &&
        lockstep_text(hello, "told/radio/parameters", parameters, sizeof parameters) &&
        lockstep_text(hello, "told/radio/report_key", report_key, sizeof report_key) &&
        lockstep_text(hello, "told/radio/status_key", status_key, sizeof status_key) &&
        lockstep_number(hello, "told/params/report_ms", &report_ms) &&
        lockstep_number(hello, "told/params/address", &train) &&
        lockstep_number(hello, "told/memory/boot_count", &boots);
    for (size_t at = 0U; good && (key[at] != '\0') && (key[at + 1U] != '\0'); at += 2U) {
        radio->key[at / 2U] = (uint8_t)((digit_of(key[at]) << 4U) | digit_of(key[at + 1U]));
    }
    for (size_t at = 0U; good && (at < 16U); at++) {
        radio->database = (radio->database << 4U) | digit_of(database[at]);
        radio->parameters = (radio->parameters << 4U) | digit_of(parameters[at]);
    }
    radio->train = (uint16_t)train;
    radio->boot = (uint32_t)boots + 1U;
    return good;
}

static void send_radio(struct controller *controller, int64_t now_ns)
{
    uint8_t bytes[RADIO_BYTES_MAX];
    size_t length = controller_status(controller, now_ns, bytes);
    (void)lockstep_send_radio(status_key, bytes, length);
    length = controller_report(controller, now_ns, bytes);
    if (length > 0U) {
        (void)lockstep_send_radio(report_key, bytes, length);
    }
}

static void cycle(struct controller *controller, int64_t now_ns)
{
    struct wire_frame frame;
    struct wire_frame sent[SENT_MAX];
    const char *key;
    const uint8_t *data;
    size_t key_length;
    size_t length;
    size_t count;
    int64_t at_ns;
    while (lockstep_frame(&frame, &at_ns)) {
        controller_take_frame(controller, &frame, at_ns);
    }
    while (lockstep_serial(&data, &length, &at_ns)) {
        controller_take_serial(controller, data, length);
    }
    while (lockstep_radio(&key, &key_length, &data, &length, &at_ns)) {
        controller_take_radio(controller, data, length, now_ns);
    }
    count = controller_cycle(controller, now_ns, sent);
    for (size_t at = 0U; at < count; at++) {
        (void)lockstep_send(&sent[at]);
    }
    if (now_ns >= report_ns) {
        send_radio(controller, now_ns);
        report_ns = now_ns + ((int64_t)report_ms * NS_PER_MS);
    }
}

int main(void)
{
    static struct settings settings;
    static struct radio radio;
    static struct controller controller;
    const char *hello = lockstep_hello();
    double start_ns = 0.0;
    int64_t now_ns = 0;
    int64_t next_ns;
    int64_t cycle_ns;
    enum lockstep_event event;
    if (hello == NULL) {
        (void)fprintf(stderr, "the bench starts this program: hil run smoke --controller ...\n");
        return 2;
    }
    if (!lockstep_number(hello, "told/start_ns", &start_ns) || !read_mission(hello, &settings) ||
        !read_train(hello, &settings) || !read_radio(hello, &radio)) {
        lockstep_refuse("line, mission or train are not as this controller needs them");
        return 0;
    }
    read_line(hello, &settings);
    controller_start(&controller, &settings, &radio);
    next_ns = (int64_t)start_ns;
    lockstep_ready("@name@ 0.1", next_ns);
    cycle_ns = (int64_t)((settings.cycle_s * NS_PER_S) + 0.5);
    event = lockstep_wait(&now_ns);
    while (event == LOCKSTEP_GRANT) {
        cycle(&controller, now_ns);
        /* The cycles stay on a grid, also where a wake-up is late. */
        while (next_ns <= now_ns) {
            next_ns += cycle_ns;
        }
        lockstep_yield(now_ns, next_ns);
        event = lockstep_wait(&now_ns);
    }
    if (event == LOCKSTEP_STOP) {
        lockstep_yield(now_ns, now_ns);
    }
    return 0;
}
