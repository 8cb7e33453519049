/* The controller: drives from station to station and opens the doors at each.
 *
 * It knows nothing of how frames travel: main.c gives it what was received and sends what it says.
 * Its supervision is simple: speed limits, end of authority, age of inputs. Replace it with your own.
 */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include "radio.h"
#include "tags.h"
#include "wire.h"

#define STOPS_MAX 32U
#define SECTIONS_MAX 64U
#define TAGS_MAX 256U
#define SENT_MAX 16U

struct stop {
    double at_m; /* Chainage of the front coupler. */
    double dwell_s;
    bool left;   /* The platform is on the left; otherwise on the right. */
};

struct section {
    double start_m;
    double end_m;
    double limit_mps;
};

struct tag {
    uint32_t id;
    double position_m;
};

/* What the controller believes of line and train. */
struct settings {
    double start_m; /* Chainage of the front coupler at the start. */
    double start_bound_m; /* The front is within start_m plus and minus this. */
    double cycle_s;
    struct stop stops[STOPS_MAX];
    uint32_t stop_count;
    struct section sections[SECTIONS_MAX];
    uint32_t section_count;
    struct tag tags[TAGS_MAX];
    uint32_t tag_count;
    double length_m;
    double mass_kg; /* With half the load, and the rotating masses as a part of it. */
    double m_per_pulse;
    double antenna_m; /* From the front coupler back to the antenna. */
};

struct inputs {
    struct TACHO tacho;
    struct BRAKE_STATUS brake;
    struct TRACTION_STATUS traction;
    struct DOOR_STATUS doors;
    struct DESK desk;
    struct TRAIN_ALARMS alarms;
    struct wire_receiver tacho_state;
    struct wire_receiver brake_state;
    struct wire_receiver traction_state;
    struct wire_receiver doors_state;
    struct wire_receiver desk_state;
    struct wire_receiver alarms_state;
};

struct outputs {
    struct wire_sender brake;
    struct wire_sender traction;
    struct wire_sender doors;
    struct wire_sender status;
    struct wire_sender motion;
    struct wire_sender position;
    struct wire_sender target;
    struct wire_sender mode;
};

struct controller {
    struct settings settings;
    struct inputs in;
    struct outputs out;
    struct tags_parser tags;
    struct radio radio;
    uint32_t rejected; /* Frames that failed the receive checks. */
    uint32_t cycles;

    /* Odometry */
    bool counted;        /* A first TACHO was received. */
    uint16_t pulses;     /* Counter of the newest TACHO. */
    uint8_t stamp_ms;    /* Its stamp. */
    int64_t tacho_ns;    /* Instant at which it was received. */
    int64_t sampled_ns;  /* Instant at which the odometer read its counter. */
    double front_m;
    double bound_m;      /* The front is within front_m plus and minus this. */
    double lag_m;        /* The front may be this much ahead, as the newest TACHO is old. */
    double speed_mps;
    double scale_ratio;  /* True distance by the distance of the nominal wheel. */
    double since_tag_m;  /* Nominal distance since the last tag. */
    double last_tag_m;
    bool tag_seen;
    uint32_t still;      /* Samples of TACHO without movement. */

    /* Operation */
    uint16_t phase; /* A value of VOBC_STATUS_ATO_PHASE. */
    uint32_t stop;  /* The next stop, or the one where the train stands. */
    double accel_mps2;
    double in_phase_s;
    double ceiling_mps;
    double emergency_mps;
    bool emergency;
    uint16_t cause;  /* A value of VOBC_MODE_CAUSE. */
    uint32_t emergencies;
    bool authorised; /* Authority and orders are fresh and the place is known. */
};

/* `radio` holds key, versions and addresses. */
void controller_start(struct controller *self, const struct settings *settings,
                      const struct radio *radio);

/* Take a received frame. `at_ns` is the instant at which it ended on the bus. */
void controller_take_frame(struct controller *self, const struct wire_frame *frame, int64_t at_ns);

/* Take bytes of the tag reader's serial line. */
void controller_take_serial(struct controller *self, const uint8_t *data, size_t length);

/* Take a message of the radio. */
void controller_take_radio(struct controller *self, const uint8_t *data, size_t length,
                           int64_t now_ns);

/* Write position report and status for the wayside. The report has no bytes, and 0 is returned,
 * while the train does not know its place. */
size_t controller_report(struct controller *self, int64_t now_ns, uint8_t bytes[RADIO_BYTES_MAX]);
size_t controller_status(struct controller *self, int64_t now_ns, uint8_t bytes[RADIO_BYTES_MAX]);

/* Decide, once a cycle. Return the number of frames to send now. */
size_t controller_cycle(struct controller *self, int64_t now_ns, struct wire_frame sent[SENT_MAX]);

#endif
