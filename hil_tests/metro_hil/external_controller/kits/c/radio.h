/* Radio messages between train and wayside: docs/reference/radio_interface.md of the bench. */
#ifndef RADIO_H
#define RADIO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define RADIO_BYTES_MAX 256U
#define RADIO_KEY_MAX 64U
#define RADIO_RESTRICTIONS_MAX 8U

struct radio_restriction {
    double start_m;
    double end_m;
    double limit_mps;
};

struct radio_authority {
    bool held;
    uint64_t term;
    uint32_t sequence;
    int64_t echo_ns; /* Stamp of the report that it answers. */
    double end_m;    /* The front must never pass this chainage. */
};

struct radio_orders {
    bool held;
    uint32_t sequence;
    int64_t echo_ns; /* Stamp of the status that they answer. */
    bool awake;
    bool hold;
    bool emergency;
    bool doors_left;
    bool doors_right;
    bool platform_doors_locked;
    struct radio_restriction restrictions[RADIO_RESTRICTIONS_MAX];
    uint32_t restriction_count;
};

struct radio {
    /* Set these first. */
    uint8_t key[RADIO_KEY_MAX]; /* Safety key of the line, with zeros behind it. */
    uint64_t database;   /* Version of the track database. */
    uint64_t parameters; /* Version of the vital parameters. */
    uint16_t train;      /* Address of this train. */
    uint32_t boot;       /* Incarnation of this program. */

    uint32_t reports;
    uint32_t statuses;
    uint32_t refused; /* Messages that were not accepted. */
    struct radio_authority authority;
    struct radio_orders orders;
};

/* Position report. The rear is not behind rear_min_m. */
struct radio_report {
    double front_min_m;
    double front_max_m;
    double rear_min_m;
    double speed_mps;
    bool standstill;
};

/* Status for centre and platforms; the numbers are those of VOBC_MODE and VOBC_STATUS. */
struct radio_status {
    uint8_t mode;
    uint8_t supervision;
    uint8_t cause;
    bool localised;
    bool standstill;
    double front_m;
    bool doors_locked;
    bool open_left;
    bool open_right;
    bool passenger_alarm;
    bool fire;
    bool obstacle;
    bool alarm_raised;
    uint32_t emergency_number;
};

/* Write a message with its safety envelope and return its length. */
size_t radio_write_report(struct radio *radio, const struct radio_report *report, int64_t now_ns,
                          uint8_t bytes[RADIO_BYTES_MAX]);
size_t radio_write_status(struct radio *radio, const struct radio_status *status, int64_t now_ns,
                          uint8_t bytes[RADIO_BYTES_MAX]);

/* Take a received message: a valid one becomes the held authority or the held orders. */
void radio_take(struct radio *radio, const uint8_t *data, size_t length, int64_t now_ns);

/* HMAC-SHA256 of a message of at most RADIO_BYTES_MAX bytes. */
void radio_hmac(const uint8_t key[RADIO_KEY_MAX], const uint8_t *data, size_t length,
                uint8_t code[32]);

#ifdef __cplusplus
}
#endif

#endif
