/* Implementation of controller.h: odometry, supervision, operation and output, in this order. */
#include "controller.h"

#include <math.h>

#define ACCEL_MPS2 0.7
#define BRAKE_MPS2 0.6       /* Deceleration at which the approach to a stop begins. */
#define BRAKE_LEAST_MPS2 0.2 /* Least demand in an approach, so that the train surely stops. */
#define BRAKE_MAX_MPS2 1.0
#define JERK_MPS3 0.55
#define GAIN_PER_S 0.6       /* Demand for each m/s of difference from the wanted speed. */
#define HOLD_MPS2 0.8        /* Service brake at standstill. */
#define BELOW_LIMIT_MPS 0.5
#define EMERGENCY_MPS 2.0    /* Emergency limit above the ceiling. */
#define REACTION_S 2.0       /* The curves begin this much before the place where they would. */
#define SPEED_REACH_MPS 0.5  /* Largest difference between the true speed and speed_mps. */
#define AUTHORITY_NS INT64_C(3000000000)
#define ORDERS_NS INT64_C(5000000000)
#define TRACKING_PER_S 8.0   /* Bandwidth of the speed filter. */
#define TACHO_S 0.02
#define STAMP_NS INT64_C(1000200)    /* A step of the odometer's stamp, by its slowest clock. */
#define SILENT_NS INT64_C(200000000) /* The stamp measures gaps up to this. */
#define STILL_SAMPLES 25U
#define DELAY_S 0.4          /* From a demand to the brake, about. */
#define WINDOW_M 0.3         /* Doors open within this distance of the stopping point. */
#define DOORS_AFTER_S 1.0
#define TAG_BOUND_M 0.15
#define BOUND_RATIO 0.06     /* Growth of the bound for each metre, before a wheel is calibrated. */
#define CALIBRATED_RATIO 0.01
#define CALIBRATE_M 100.0    /* Least distance of two tags that calibrate the wheel. */
#define LOCALISED_M 30.0

void controller_start(struct controller *self, const struct settings *settings,
                      const struct radio *radio)
{
    static const struct controller none = {0};
    *self = none;
    self->settings = *settings;
    self->radio = *radio;
    self->front_m = settings->start_m;
    self->bound_m = settings->start_bound_m;
    self->scale_ratio = 1.0;
    self->still = STILL_SAMPLES;
    self->phase = VOBC_STATUS_ATO_PHASE_HOLDING;
}

/* Odometry */

/* The counter has 16 bits. Half its range is far more than a train moves between two readings. */
static int32_t steps_between(uint16_t first, uint16_t last)
{
    return (int32_t)((last - first + 0x18000) & 0xFFFF) - 0x8000;
}

/* A late TACHO is an old sample. The one that came fastest shows how the odometer's clock goes. */
static void take_stamp(struct controller *self, int64_t at_ns)
{
    const uint8_t stamp_ms = (uint8_t)self->in.tacho.stamp_ms;
    const uint8_t since_ms = (uint8_t)(stamp_ms - self->stamp_ms);
    const bool measured = self->counted && ((at_ns - self->tacho_ns) < SILENT_NS);
    const int64_t sampled_ns = self->sampled_ns + ((int64_t)since_ms * STAMP_NS);
    self->sampled_ns = (measured && (sampled_ns < at_ns)) ? sampled_ns : at_ns;
    self->stamp_ms = stamp_ms;
    self->tacho_ns = at_ns;
}

static void take_tacho(struct controller *self, int64_t at_ns)
{
    const uint16_t pulses = (uint16_t)self->in.tacho.pulses_a;
    take_stamp(self, at_ns);
    if (self->counted) {
        const int32_t step = steps_between(self->pulses, pulses);
        const double moved_m = (double)step * self->settings.m_per_pulse;
        const double ratio = self->tag_seen ? CALIBRATED_RATIO : BOUND_RATIO;
        self->since_tag_m += moved_m;
        self->front_m += moved_m * self->scale_ratio;
        self->bound_m += fabs(moved_m) * ratio;
        self->still = (step == 0) ? (self->still + 1U) : 0U;
        self->speed_mps += TRACKING_PER_S * TACHO_S *
                           (((moved_m * self->scale_ratio) / TACHO_S) - self->speed_mps);
        if (self->still >= STILL_SAMPLES) {
            self->speed_mps = 0.0;
        }
    }
    self->counted = true;
    self->pulses = pulses;
}

static void take_tag(struct controller *self, const struct tags_telegram *telegram)
{
    for (uint32_t at = 0U; at < self->settings.tag_count; at++) {
        const struct tag *tag = &self->settings.tags[at];
        if ((tag->id == telegram->tag_id) && self->counted) {
            const int32_t since = steps_between(telegram->pulses, self->pulses);
            const double past_m = (double)since * self->settings.m_per_pulse;
            const double apart_m = tag->position_m - self->last_tag_m;
            const double nominal_m = self->since_tag_m - past_m;
            if ((apart_m >= CALIBRATE_M) && (self->last_tag_m > 0.0) && (nominal_m > 0.0)) {
                self->scale_ratio = apart_m / nominal_m;
                self->tag_seen = true;
            }
            self->last_tag_m = tag->position_m;
            self->since_tag_m = past_m;
            self->front_m = tag->position_m + self->settings.antenna_m +
                            (past_m * self->scale_ratio);
            self->bound_m = TAG_BOUND_M + (fabs(past_m) * BOUND_RATIO);
        }
    }
}

/* Distance that the train may have run since the newest sample. */
static double lag_m(const struct controller *self, int64_t now_ns)
{
    const double age_s = self->counted ? ((double)(now_ns - self->sampled_ns) / 1e9) : 0.0;
    return fabs(self->speed_mps) * age_s;
}

/* Supervision */

static bool stands(const struct controller *self)
{
    return self->still >= STILL_SAMPLES;
}

/* Highest speed now from which the train comes down to `limit_mps` at the chainage `from_m`. */
static double before_mps(const struct controller *self, double from_m, double limit_mps)
{
    const double reach_m = self->front_m + self->bound_m + (self->speed_mps * REACTION_S);
    return sqrt((limit_mps * limit_mps) + (2.0 * BRAKE_MPS2 * fmax(0.0, from_m - reach_m)));
}

static double ceiling_mps(const struct controller *self)
{
    const struct settings *settings = &self->settings;
    const struct radio_orders *orders = &self->radio.orders;
    const double rear_m = self->front_m - settings->length_m - self->bound_m;
    double least_mps = before_mps(self, self->radio.authority.end_m, 0.0);
    for (uint32_t at = 0U; at < settings->section_count; at++) {
        const struct section *section = &settings->sections[at];
        if (section->end_m > rear_m) {
            least_mps = fmin(least_mps, before_mps(self, section->start_m, section->limit_mps));
        }
    }
    for (uint32_t at = 0U; at < orders->restriction_count; at++) {
        const struct radio_restriction *each = &orders->restrictions[at];
        if (each->end_m > rear_m) {
            least_mps = fmin(least_mps, before_mps(self, each->start_m, each->limit_mps));
        }
    }
    return least_mps;
}

static bool inputs_are_fresh(const struct controller *self, int64_t now_ns)
{
    const struct inputs *in = &self->in;
    return wire_is_fresh(&wire_messages[WIRE_AT_TACHO], &in->tacho_state, now_ns) &&
           wire_is_fresh(&wire_messages[WIRE_AT_BRAKE_STATUS], &in->brake_state, now_ns) &&
           wire_is_fresh(&wire_messages[WIRE_AT_TRACTION_STATUS], &in->traction_state, now_ns) &&
           wire_is_fresh(&wire_messages[WIRE_AT_DOOR_STATUS], &in->doors_state, now_ns) &&
           wire_is_fresh(&wire_messages[WIRE_AT_DESK], &in->desk_state, now_ns) &&
           wire_is_fresh(&wire_messages[WIRE_AT_TRAIN_ALARMS], &in->alarms_state, now_ns);
}

static bool is_authorised(const struct controller *self, int64_t now_ns)
{
    const struct radio_authority *authority = &self->radio.authority;
    const struct radio_orders *orders = &self->radio.orders;
    return authority->held && ((now_ns - authority->echo_ns) <= AUTHORITY_NS) && orders->held &&
           ((now_ns - orders->echo_ns) <= ORDERS_NS) && (self->bound_m < LOCALISED_M);
}

/* Why the emergency brake has to be applied now. */
static uint16_t cause_of_emergency(const struct controller *self, bool fresh)
{
    uint16_t cause = VOBC_MODE_CAUSE_NONE;
    if (!self->in.desk.emergency_released) {
        cause = VOBC_MODE_CAUSE_BUTTON;
    } else if (self->radio.orders.held && self->radio.orders.emergency) {
        cause = VOBC_MODE_CAUSE_REMOTE;
    } else if (!self->in.alarms.no_obstacle) {
        cause = VOBC_MODE_CAUSE_OBSTACLE;
    } else if (stands(self)) {
        cause = VOBC_MODE_CAUSE_NONE;
    } else if (!fresh) {
        cause = VOBC_MODE_CAUSE_VITAL_INPUT_LOST;
    } else if (!self->authorised) {
        cause = VOBC_MODE_CAUSE_AUTHORITY_OLD;
    } else if (!self->in.doors.closed_and_locked) {
        cause = VOBC_MODE_CAUSE_DOOR_UNLOCKED;
    } else if ((self->speed_mps + SPEED_REACH_MPS) > self->emergency_mps) {
        cause = VOBC_MODE_CAUSE_OVERSPEED;
    } else {
        cause = VOBC_MODE_CAUSE_NONE;
    }
    return cause;
}

static void supervise(struct controller *self, bool fresh, int64_t now_ns)
{
    uint16_t cause;
    self->authorised = is_authorised(self, now_ns);
    self->ceiling_mps = ceiling_mps(self);
    self->emergency_mps = self->ceiling_mps + EMERGENCY_MPS;
    cause = cause_of_emergency(self, fresh);
    if (self->in.desk_state.received && (cause != (uint16_t)VOBC_MODE_CAUSE_NONE)) {
        self->emergencies += self->emergency ? 0U : 1U;
        self->cause = self->emergency ? self->cause : cause;
        self->emergency = true;
        self->accel_mps2 = 0.0;
    } else if (stands(self) && fresh && self->in.desk.reset_requested) {
        /* The emergency brake stays until a person resets it at standstill. */
        self->emergency = false;
        self->cause = VOBC_MODE_CAUSE_NONE;
    } else {
        /* Nothing changes. */
    }
}

/* Operation */

static void enter(struct controller *self, uint16_t phase)
{
    self->phase = phase;
    self->in_phase_s = 0.0;
}

static bool may_depart(const struct controller *self, bool fresh)
{
    return fresh && !self->emergency && self->authorised && self->radio.orders.awake &&
           !self->radio.orders.hold && self->radio.orders.platform_doors_locked &&
           self->in.alarms.no_fire && (self->stop < self->settings.stop_count) &&
           self->in.doors.closed_and_locked && self->in.brake.ready && self->in.traction.ready &&
           (self->in.desk.mode == (uint16_t)DESK_MODE_AUTO);
}

static double to_stop_m(const struct controller *self)
{
    return self->settings.stops[self->stop].at_m - self->front_m;
}

static bool doors_may_open(const struct controller *self)
{
    const struct radio_orders *orders = &self->radio.orders;
    return self->authorised &&
           (self->settings.stops[self->stop].left ? orders->doors_left : orders->doors_right);
}

/* The acceleration that the train should have now, before the limit of the jerk. */
static double wanted_mps2(struct controller *self)
{
    /* The filtered speed is late by the inverse of its bandwidth. */
    const double speed_mps = fmax(0.0, self->speed_mps + (self->accel_mps2 / TRACKING_PER_S));
    const double left_m = fmax(0.05, to_stop_m(self));
    const double ahead_m = fmax(0.05, left_m - (speed_mps * DELAY_S));
    const double needed_mps2 = (speed_mps * speed_mps) / (2.0 * left_m);
    double wanted = GAIN_PER_S * ((self->ceiling_mps - BELOW_LIMIT_MPS) - speed_mps);
    if ((self->phase == VOBC_STATUS_ATO_PHASE_RUNNING) &&
        (((speed_mps * speed_mps) / (2.0 * ahead_m)) >= BRAKE_MPS2)) {
        enter(self, VOBC_STATUS_ATO_PHASE_APPROACHING);
    }
    if (self->phase == VOBC_STATUS_ATO_PHASE_APPROACHING) {
        wanted = fmin(wanted, -fmax(needed_mps2, BRAKE_LEAST_MPS2));
    }
    return fmax(-BRAKE_MAX_MPS2, fmin(ACCEL_MPS2, wanted));
}

static void operate(struct controller *self, bool fresh)
{
    const double step_mps2 = JERK_MPS3 * self->settings.cycle_s;
    double wanted = 0.0;
    self->in_phase_s += self->settings.cycle_s;
    switch (self->phase) {
    case VOBC_STATUS_ATO_PHASE_HOLDING:
        if (may_depart(self, fresh) && (self->in_phase_s >= 1.0)) {
            enter(self, VOBC_STATUS_ATO_PHASE_RUNNING);
        }
        break;
    case VOBC_STATUS_ATO_PHASE_RUNNING:
    case VOBC_STATUS_ATO_PHASE_APPROACHING:
        wanted = wanted_mps2(self);
        self->accel_mps2 = fmax(self->accel_mps2 - step_mps2,
                                fmin(self->accel_mps2 + step_mps2, wanted));
        if (stands(self) && (self->phase == VOBC_STATUS_ATO_PHASE_APPROACHING)) {
            enter(self, VOBC_STATUS_ATO_PHASE_STOPPED);
        }
        break;
    case VOBC_STATUS_ATO_PHASE_STOPPED:
        if ((self->in_phase_s >= DOORS_AFTER_S) && (fabs(to_stop_m(self)) <= WINDOW_M) &&
            doors_may_open(self)) {
            enter(self, VOBC_STATUS_ATO_PHASE_DOORS_OPEN);
        }
        break;
    case VOBC_STATUS_ATO_PHASE_DOORS_OPEN:
        if ((self->in_phase_s >= self->settings.stops[self->stop].dwell_s) &&
            ((self->stop + 1U) < self->settings.stop_count)) {
            self->stop++;
            enter(self, VOBC_STATUS_ATO_PHASE_HOLDING);
        }
        break;
    default:
        enter(self, VOBC_STATUS_ATO_PHASE_HOLDING);
        break;
    }
}

/* Output */

static bool drives(const struct controller *self)
{
    return !self->emergency && ((self->phase == VOBC_STATUS_ATO_PHASE_RUNNING) ||
                                (self->phase == VOBC_STATUS_ATO_PHASE_APPROACHING));
}

static bool opens(const struct controller *self, bool left)
{
    return (self->phase == VOBC_STATUS_ATO_PHASE_DOORS_OPEN) &&
           (self->settings.stops[self->stop].left == left);
}

static size_t send_commands(struct controller *self, struct wire_frame *sent)
{
    const bool driving = drives(self);
    const bool left = opens(self, true);
    const bool right = opens(self, false);
    const double accel_mps2 = driving ? self->accel_mps2 : -HOLD_MPS2;
    const bool pulls = driving && (accel_mps2 > 0.0);
    struct BRAKE_CMD brake = {0};
    struct TRACTION_CMD traction = {0};
    struct DOOR_CMD doors = {0};
    size_t count = 0U;
    brake.service_decel_mps2 = self->emergency ? BRAKE_MAX_MPS2 : fmax(0.0, -accel_mps2);
    brake.emergency_released = !self->emergency;
    brake.holding_released = driving;
    traction.force_n = pulls ? (accel_mps2 * self->settings.mass_kg) : 0.0;
    traction.direction = TRACTION_CMD_DIRECTION_FORWARD;
    traction.traction_permitted = pulls;
    doors.enable_left = left;
    doors.open_left = left;
    doors.enable_right = right;
    doors.open_right = right;
    count += wire_send_BRAKE_CMD(&self->out.brake, &brake, &sent[count]);
    count += wire_send_TRACTION_CMD(&self->out.traction, &traction, &sent[count]);
    if ((self->cycles % 2U) == 0U) {
        count += wire_send_DOOR_CMD(&self->out.doors, &doors, &sent[count]);
    }
    return count;
}

static uint16_t supervision_of(const struct controller *self)
{
    uint16_t state = VOBC_STATUS_SUPERVISION_NO_AUTHORITY;
    if (self->emergency) {
        state = VOBC_STATUS_SUPERVISION_EMERGENCY;
    } else if (self->authorised) {
        state = VOBC_STATUS_SUPERVISION_NOMINAL;
    } else {
        state = VOBC_STATUS_SUPERVISION_NO_AUTHORITY;
    }
    return state;
}

static uint16_t mode_of(const struct controller *self)
{
    return self->authorised ? VOBC_MODE_MODE_AUTHORISED : VOBC_MODE_MODE_STANDBY;
}

static size_t send_state(struct controller *self, struct wire_frame *sent)
{
    struct VOBC_STATUS status = {0};
    struct VOBC_MOTION motion = {0};
    struct VOBC_POSITION position = {0};
    struct VOBC_TARGET target = {0};
    struct VOBC_MODE mode = {0};
    size_t count = 0U;
    status.supervision = supervision_of(self);
    status.missing = self->authorised ? VOBC_STATUS_MISSING_NOTHING : VOBC_STATUS_MISSING_AUTHORITY;
    status.ato_phase = self->phase;
    status.localised = self->bound_m < LOCALISED_M;
    motion.speed_mps = self->speed_mps;
    motion.ceiling_mps = self->ceiling_mps;
    motion.emergency_mps = self->emergency_mps;
    position.front_m = self->front_m;
    position.uncertainty_m = self->bound_m + self->lag_m;
    target.distance_to_stop_m = to_stop_m(self);
    target.distance_to_authority_m =
        self->radio.authority.end_m - (self->front_m + self->bound_m);
    mode.mode = mode_of(self);
    mode.cause = self->cause;
    mode.replicas_agree = true; /* There is one computation only. */
    mode.speed_reach_mps = SPEED_REACH_MPS;
    count += wire_send_VOBC_STATUS(&self->out.status, &status, &sent[count]);
    if ((self->cycles % 2U) == 0U) {
        count += wire_send_VOBC_MOTION(&self->out.motion, &motion, &sent[count]);
        count += wire_send_VOBC_MODE(&self->out.mode, &mode, &sent[count]);
        count += wire_send_VOBC_POSITION(&self->out.position, &position, &sent[count]);
    }
    if ((self->cycles % 4U) == 0U) {
        count += wire_send_VOBC_TARGET(&self->out.target, &target, &sent[count]);
    }
    return count;
}

/* The interface */

void controller_take_frame(struct controller *self, const struct wire_frame *frame, int64_t at_ns)
{
    struct inputs *in = &self->in;
    enum wire_verdict verdict = WIRE_ACCEPTED;
    switch (frame->id) {
    case WIRE_ID_TACHO:
        verdict = wire_receive_TACHO(&in->tacho_state, frame, at_ns, &in->tacho);
        if (verdict == WIRE_ACCEPTED) {
            take_tacho(self, at_ns);
        }
        break;
    case WIRE_ID_BRAKE_STATUS:
        verdict = wire_receive_BRAKE_STATUS(&in->brake_state, frame, at_ns, &in->brake);
        break;
    case WIRE_ID_TRACTION_STATUS:
        verdict = wire_receive_TRACTION_STATUS(&in->traction_state, frame, at_ns, &in->traction);
        break;
    case WIRE_ID_DOOR_STATUS:
        verdict = wire_receive_DOOR_STATUS(&in->doors_state, frame, at_ns, &in->doors);
        break;
    case WIRE_ID_DESK:
        verdict = wire_receive_DESK(&in->desk_state, frame, at_ns, &in->desk);
        break;
    case WIRE_ID_TRAIN_ALARMS:
        verdict = wire_receive_TRAIN_ALARMS(&in->alarms_state, frame, at_ns, &in->alarms);
        break;
    default:
        /* This controller needs no other frame. */
        break;
    }
    self->rejected += (verdict > WIRE_FIRST_HALF) ? 1U : 0U;
}

void controller_take_serial(struct controller *self, const uint8_t *data, size_t length)
{
    struct tags_telegram telegram;
    for (size_t at = 0U; at < length; at++) {
        if (tags_take(&self->tags, data[at], &telegram)) {
            take_tag(self, &telegram);
        }
    }
}

void controller_take_radio(struct controller *self, const uint8_t *data, size_t length,
                           int64_t now_ns)
{
    radio_take(&self->radio, data, length, now_ns);
}

size_t controller_report(struct controller *self, int64_t now_ns, uint8_t bytes[RADIO_BYTES_MAX])
{
    size_t length = 0U;
    if (self->bound_m < LOCALISED_M) {
        struct radio_report report;
        report.front_min_m = self->front_m - self->bound_m;
        report.front_max_m = self->front_m + self->bound_m + self->lag_m;
        report.rear_min_m = report.front_min_m - self->settings.length_m;
        report.speed_mps = self->speed_mps;
        report.standstill = stands(self);
        length = radio_write_report(&self->radio, &report, now_ns, bytes);
    }
    return length;
}

size_t controller_status(struct controller *self, int64_t now_ns, uint8_t bytes[RADIO_BYTES_MAX])
{
    struct radio_status status = {0};
    status.mode = (uint8_t)mode_of(self);
    status.supervision = (uint8_t)supervision_of(self);
    status.cause = (uint8_t)self->cause;
    status.localised = self->bound_m < LOCALISED_M;
    status.standstill = stands(self);
    status.front_m = self->front_m;
    status.doors_locked = self->in.doors_state.received && self->in.doors.closed_and_locked;
    status.open_left = opens(self, true);
    status.open_right = opens(self, false);
    status.passenger_alarm = self->in.desk_state.received && !self->in.desk.no_passenger_alarm;
    status.fire = self->in.alarms_state.received && !self->in.alarms.no_fire;
    status.obstacle = self->in.alarms_state.received && !self->in.alarms.no_obstacle;
    status.alarm_raised = status.passenger_alarm || status.fire || status.obstacle;
    status.emergency_number = self->emergencies;
    return radio_write_status(&self->radio, &status, now_ns, bytes);
}

size_t controller_cycle(struct controller *self, int64_t now_ns, struct wire_frame sent[SENT_MAX])
{
    const bool fresh = inputs_are_fresh(self, now_ns);
    size_t count;
    self->lag_m = lag_m(self, now_ns);
    supervise(self, fresh, now_ns);
    operate(self, fresh);
    count = send_commands(self, sent);
    count += send_state(self, &sent[count]);
    self->cycles++;
    return count;
}
