//! The controller: drives from station to station and opens the doors at each.
//!
//! It knows nothing of how frames travel: main.rs gives it what was received and sends what it says.
//! Its supervision is simple: speed limits, end of authority, age of inputs. Replace it with your
//! own.

use crate::radio::{Radio, Value, AUTHORITY_NS, ORDERS_NS};
use crate::tags::TagParser;
use crate::wire::*;

const ACCEL_MPS2: f64 = 0.7;
/// Deceleration at which the approach to a stop begins.
const BRAKE_MPS2: f64 = 0.6;
const BRAKE_LEAST_MPS2: f64 = 0.2;
const BRAKE_MAX_MPS2: f64 = 1.0;
const JERK_MPS3: f64 = 0.55;
/// Demand for each m/s of difference from the wanted speed.
const GAIN_PER_S: f64 = 0.6;
const HOLD_MPS2: f64 = 0.8;
const BELOW_LIMIT_MPS: f64 = 0.5;
/// Emergency limit above the ceiling.
const EMERGENCY_MPS: f64 = 2.0;
const REACTION_S: f64 = 2.0;
const SPEED_REACH_MPS: f64 = 0.5;
/// Bandwidth of the speed filter.
const TRACKING_PER_S: f64 = 8.0;
const TACHO_S: f64 = 0.02;
/// A step of the odometer's stamp, by its slowest clock.
const STAMP_NS: i64 = 1_000_200;
/// The stamp measures gaps up to this.
const SILENT_NS: i64 = 200_000_000;
const STILL_SAMPLES: u32 = 25;
const DELAY_S: f64 = 0.4;
const WINDOW_M: f64 = 0.3;
const DOORS_AFTER_S: f64 = 1.0;
const TAG_BOUND_M: f64 = 0.15;
const BOUND_RATIO: f64 = 0.06;
const CALIBRATED_RATIO: f64 = 0.01;
const CALIBRATE_M: f64 = 100.0;
const LOCALISED_M: f64 = 30.0;

pub struct Stop {
    /// Chainage of the front coupler.
    pub at_m: f64,
    pub dwell_s: f64,
    /// The platform is on the left; otherwise on the right.
    pub left: bool,
}

/// What the controller believes of line and train.
pub struct Settings {
    pub start_m: f64,
    pub start_bound_m: f64,
    pub cycle_s: f64,
    pub stops: Vec<Stop>,
    /// Start, end and limit of each speed section.
    pub limits: Vec<(f64, f64, f64)>,
    pub tags: Vec<(u32, f64)>,
    pub length_m: f64,
    /// With half the load, and the rotating masses as a part of it.
    pub mass_kg: f64,
    pub m_per_pulse: f64,
    /// From the front coupler back to the antenna.
    pub antenna_m: f64,
}

struct Inputs {
    tacho: Receiver<TACHO>,
    brake: Receiver<BRAKE_STATUS>,
    traction: Receiver<TRACTION_STATUS>,
    doors: Receiver<DOOR_STATUS>,
    desk: Receiver<DESK>,
    alarms: Receiver<TRAIN_ALARMS>,
}

struct Outputs {
    brake: Sender<BRAKE_CMD>,
    traction: Sender<TRACTION_CMD>,
    doors: Sender<DOOR_CMD>,
    status: Sender<VOBC_STATUS>,
    motion: Sender<VOBC_MOTION>,
    mode: Sender<VOBC_MODE>,
    position: Sender<VOBC_POSITION>,
    target: Sender<VOBC_TARGET>,
}

pub struct Controller {
    pub radio: Radio,
    pub rejected: u32,
    settings: Settings,
    inputs: Inputs,
    outputs: Outputs,
    parser: TagParser,
    cycles: u64,
    pulses: Option<u16>,
    /// Stamp of the newest TACHO, and the instant at which it was received.
    stamp_ms: u8,
    tacho_ns: i64,
    /// Instant at which the odometer read its newest counter.
    sampled_ns: i64,
    front_m: f64,
    /// The front is within front_m plus and minus this.
    bound_m: f64,
    /// The front may be this much ahead, as the newest TACHO is old.
    lag_m: f64,
    speed_mps: f64,
    /// True distance by the distance of the nominal wheel.
    scale_ratio: f64,
    since_tag_m: f64,
    last_tag_m: Option<f64>,
    calibrated: bool,
    /// Samples of TACHO without movement.
    still: u32,
    phase: u16,
    in_phase_s: f64,
    /// The next stop, or the one where the train stands.
    stop: usize,
    accel_mps2: f64,
    ceiling_mps: f64,
    authorised: bool,
    emergency: bool,
    cause: u16,
    emergencies: u64,
}

impl Controller {
    pub fn new(settings: Settings, radio: Radio) -> Self {
        Controller {
            radio,
            rejected: 0,
            inputs: Inputs {
                tacho: Receiver::new(),
                brake: Receiver::new(),
                traction: Receiver::new(),
                doors: Receiver::new(),
                desk: Receiver::new(),
                alarms: Receiver::new(),
            },
            outputs: Outputs {
                brake: Sender::new(),
                traction: Sender::new(),
                doors: Sender::new(),
                status: Sender::new(),
                motion: Sender::new(),
                mode: Sender::new(),
                position: Sender::new(),
                target: Sender::new(),
            },
            parser: TagParser::default(),
            cycles: 0,
            pulses: None,
            stamp_ms: 0,
            tacho_ns: 0,
            sampled_ns: 0,
            front_m: settings.start_m,
            bound_m: settings.start_bound_m,
            lag_m: 0.0,
            speed_mps: 0.0,
            scale_ratio: 1.0,
            since_tag_m: 0.0,
            last_tag_m: None,
            calibrated: false,
            still: STILL_SAMPLES,
            phase: VOBC_STATUS_ATO_PHASE_HOLDING,
            in_phase_s: 0.0,
            stop: 0,
            accel_mps2: 0.0,
            ceiling_mps: 0.0,
            authorised: false,
            emergency: false,
            cause: VOBC_MODE_CAUSE_NONE,
            emergencies: 0,
            settings,
        }
    }

    // Odometry

    pub fn take_frame(&mut self, frame: &CanFrame, at_ns: i64) {
        let inputs = &mut self.inputs;
        let verdict = if frame.id == TACHO::MESSAGE.id {
            let verdict = inputs.tacho.receive(frame, at_ns);
            if verdict == Verdict::Accepted {
                self.take_stamp(at_ns);
                self.take_tacho();
            }
            verdict
        } else if frame.id == BRAKE_STATUS::MESSAGE.id {
            inputs.brake.receive(frame, at_ns)
        } else if frame.id == TRACTION_STATUS::MESSAGE.id {
            inputs.traction.receive(frame, at_ns)
        } else if frame.id == DOOR_STATUS::MESSAGE.id {
            inputs.doors.receive(frame, at_ns)
        } else if frame.id == DESK::MESSAGE.id {
            inputs.desk.receive(frame, at_ns)
        } else if frame.id == TRAIN_ALARMS::MESSAGE.id {
            inputs.alarms.receive(frame, at_ns)
        } else {
            return; // This controller needs no other frame.
        };
        self.rejected += u32::from(verdict != Verdict::Accepted);
    }

    /// A late TACHO is an old sample. The one that came fastest shows how the odometer's clock goes.
    fn take_stamp(&mut self, at_ns: i64) {
        let stamp_ms = self.inputs.tacho.values.stamp_ms as u8;
        let mut sampled_ns = at_ns;
        if self.pulses.is_some() && at_ns - self.tacho_ns < SILENT_NS {
            let since_ms = stamp_ms.wrapping_sub(self.stamp_ms);
            sampled_ns = at_ns.min(self.sampled_ns + i64::from(since_ms) * STAMP_NS);
        }
        self.sampled_ns = sampled_ns;
        self.stamp_ms = stamp_ms;
        self.tacho_ns = at_ns;
    }

    fn take_tacho(&mut self) {
        let pulses = self.inputs.tacho.values.pulses_a as u16;
        if let Some(last) = self.pulses {
            let step = steps_between(last, pulses);
            let moved_m = f64::from(step) * self.settings.m_per_pulse;
            let ratio = if self.calibrated { CALIBRATED_RATIO } else { BOUND_RATIO };
            self.since_tag_m += moved_m;
            self.front_m += moved_m * self.scale_ratio;
            self.bound_m += moved_m.abs() * ratio;
            self.still = if step == 0 { self.still.saturating_add(1) } else { 0 };
            let now_mps = moved_m * self.scale_ratio / TACHO_S;
            self.speed_mps += TRACKING_PER_S * TACHO_S * (now_mps - self.speed_mps);
            if self.stands() {
                self.speed_mps = 0.0;
            }
        }
        self.pulses = Some(pulses);
    }

    pub fn take_serial(&mut self, data: &[u8]) {
        for tag in self.parser.take(data) {
            let place_m = self.settings.tags.iter().find(|(id, _)| *id == tag.id);
            let (Some((_, place_m)), Some(pulses)) = (place_m, self.pulses) else {
                continue;
            };
            let past_m = f64::from(steps_between(tag.pulses, pulses)) * self.settings.m_per_pulse;
            let nominal_m = self.since_tag_m - past_m;
            let apart_m = self.last_tag_m.map_or(0.0, |last_m| place_m - last_m);
            if apart_m >= CALIBRATE_M && nominal_m > 0.0 {
                self.scale_ratio = apart_m / nominal_m;
                self.calibrated = true;
            }
            self.last_tag_m = Some(*place_m);
            self.since_tag_m = past_m;
            self.front_m = place_m + self.settings.antenna_m + past_m * self.scale_ratio;
            self.bound_m = TAG_BOUND_M + past_m.abs() * BOUND_RATIO;
        }
    }

    fn stands(&self) -> bool {
        self.still >= STILL_SAMPLES
    }

    fn localised(&self) -> bool {
        self.bound_m < LOCALISED_M
    }

    // Supervision

    /// Highest speed now from which the train comes down to the limit at this chainage.
    fn before_mps(&self, from_m: f64, limit_mps: f64) -> f64 {
        let reach_m = self.front_m + self.bound_m + self.speed_mps * REACTION_S;
        (limit_mps * limit_mps + 2.0 * BRAKE_MPS2 * (from_m - reach_m).max(0.0)).sqrt()
    }

    fn ceiling_now_mps(&self) -> f64 {
        let rear_m = self.front_m - self.settings.length_m - self.bound_m;
        let end_m = self.radio.authority.as_ref().map_or(self.front_m, |held| held.end_m);
        let orders = self.radio.orders.as_ref();
        let restrictions = orders.map_or(&[][..], |held| &held.restrictions[..]);
        let limits = self.settings.limits.iter().chain(restrictions);
        limits
            .filter(|(_, end_m, _)| *end_m > rear_m)
            .map(|(start_m, _, limit_mps)| self.before_mps(*start_m, *limit_mps))
            .fold(self.before_mps(end_m, 0.0), f64::min)
    }

    /// Decide on the emergency brake; return whether all inputs are fresh.
    fn supervise(&mut self, now_ns: i64) -> bool {
        let young = |echo_ns: i64, most_ns: i64| now_ns - echo_ns <= most_ns;
        let authority = self.radio.authority.as_ref();
        let orders = self.radio.orders.as_ref();
        self.authorised = authority.is_some_and(|held| young(held.echo_ns, AUTHORITY_NS))
            && orders.is_some_and(|held| young(held.echo_ns, ORDERS_NS))
            && self.localised();
        self.ceiling_mps = self.ceiling_now_mps();
        let inputs = &self.inputs;
        let fresh = inputs.tacho.is_fresh(now_ns)
            && inputs.brake.is_fresh(now_ns)
            && inputs.traction.is_fresh(now_ns)
            && inputs.doors.is_fresh(now_ns)
            && inputs.desk.is_fresh(now_ns)
            && inputs.alarms.is_fresh(now_ns);
        if inputs.desk.received_ns.is_none() || inputs.alarms.received_ns.is_none() {
            return fresh;
        }
        let cause = self.cause_of_emergency(fresh);
        if cause != VOBC_MODE_CAUSE_NONE {
            if !self.emergency {
                self.emergencies += 1;
                self.cause = cause;
            }
            self.emergency = true;
            self.accel_mps2 = 0.0;
        } else if self.stands() && fresh && self.inputs.desk.values.reset_requested {
            // The emergency brake stays until a person resets it at standstill.
            self.emergency = false;
            self.cause = VOBC_MODE_CAUSE_NONE;
        }
        fresh
    }

    fn cause_of_emergency(&self, fresh: bool) -> u16 {
        let inputs = &self.inputs;
        if !inputs.desk.values.emergency_released {
            VOBC_MODE_CAUSE_BUTTON
        } else if self.radio.orders.as_ref().is_some_and(|held| held.emergency) {
            VOBC_MODE_CAUSE_REMOTE
        } else if !inputs.alarms.values.no_obstacle {
            VOBC_MODE_CAUSE_OBSTACLE
        } else if self.stands() {
            VOBC_MODE_CAUSE_NONE
        } else if !fresh {
            VOBC_MODE_CAUSE_VITAL_INPUT_LOST
        } else if !self.authorised {
            VOBC_MODE_CAUSE_AUTHORITY_OLD
        } else if !inputs.doors.values.closed_and_locked {
            VOBC_MODE_CAUSE_DOOR_UNLOCKED
        } else if self.speed_mps + SPEED_REACH_MPS > self.ceiling_mps + EMERGENCY_MPS {
            VOBC_MODE_CAUSE_OVERSPEED
        } else {
            VOBC_MODE_CAUSE_NONE
        }
    }

    // Operation

    fn enter(&mut self, phase: u16) {
        self.phase = phase;
        self.in_phase_s = 0.0;
    }

    fn may_depart(&self, fresh: bool) -> bool {
        let inputs = &self.inputs;
        let ordered = self
            .radio
            .orders
            .as_ref()
            .is_some_and(|held| held.awake && !held.hold && held.platform_doors_locked);
        fresh
            && ordered
            && self.authorised
            && !self.emergency
            && inputs.alarms.values.no_fire
            && inputs.doors.values.closed_and_locked
            && inputs.brake.values.ready
            && inputs.traction.values.ready
            && inputs.desk.values.mode == DESK_MODE_AUTO
    }

    fn to_stop_m(&self) -> f64 {
        self.settings.stops[self.stop].at_m - self.front_m
    }

    fn opens(&self, left: bool) -> bool {
        self.phase == VOBC_STATUS_ATO_PHASE_DOORS_OPEN
            && self.settings.stops[self.stop].left == left
    }

    fn doors_may_open(&self) -> bool {
        let left = self.settings.stops[self.stop].left;
        let orders = self.radio.orders.as_ref();
        self.authorised
            && orders.is_some_and(|held| if left { held.doors_left } else { held.doors_right })
    }

    fn wanted_mps2(&mut self) -> f64 {
        // The filtered speed is late by the inverse of its bandwidth.
        let speed_mps = (self.speed_mps + self.accel_mps2 / TRACKING_PER_S).max(0.0);
        let left_m = self.to_stop_m().max(0.05);
        let ahead_m = (left_m - speed_mps * DELAY_S).max(0.05);
        let mut wanted = GAIN_PER_S * (self.ceiling_mps - BELOW_LIMIT_MPS - speed_mps);
        if self.phase == VOBC_STATUS_ATO_PHASE_RUNNING
            && speed_mps * speed_mps / (2.0 * ahead_m) >= BRAKE_MPS2
        {
            self.enter(VOBC_STATUS_ATO_PHASE_APPROACHING);
        }
        if self.phase == VOBC_STATUS_ATO_PHASE_APPROACHING {
            let needed_mps2 = speed_mps * speed_mps / (2.0 * left_m);
            wanted = wanted.min(-needed_mps2.max(BRAKE_LEAST_MPS2));
        }
        wanted.min(ACCEL_MPS2).max(-BRAKE_MAX_MPS2)
    }

    fn operate(&mut self, fresh: bool) {
        self.in_phase_s += self.settings.cycle_s;
        match self.phase {
            VOBC_STATUS_ATO_PHASE_HOLDING => {
                if self.in_phase_s >= 1.0 && self.may_depart(fresh) {
                    self.enter(VOBC_STATUS_ATO_PHASE_RUNNING);
                }
            }
            VOBC_STATUS_ATO_PHASE_RUNNING | VOBC_STATUS_ATO_PHASE_APPROACHING => {
                let step = JERK_MPS3 * self.settings.cycle_s;
                let wanted = self.wanted_mps2();
                self.accel_mps2 = wanted.min(self.accel_mps2 + step).max(self.accel_mps2 - step);
                if self.stands() && self.phase == VOBC_STATUS_ATO_PHASE_APPROACHING {
                    self.enter(VOBC_STATUS_ATO_PHASE_STOPPED);
                }
            }
            VOBC_STATUS_ATO_PHASE_STOPPED => {
                let there = self.to_stop_m().abs() <= WINDOW_M;
                if self.in_phase_s >= DOORS_AFTER_S && there && self.doors_may_open() {
                    self.enter(VOBC_STATUS_ATO_PHASE_DOORS_OPEN);
                }
            }
            _ => {
                let dwelt = self.in_phase_s >= self.settings.stops[self.stop].dwell_s;
                if dwelt && self.stop + 1 < self.settings.stops.len() {
                    self.stop += 1;
                    self.enter(VOBC_STATUS_ATO_PHASE_HOLDING);
                }
            }
        }
    }

    // Output

    fn supervision(&self) -> u16 {
        if self.emergency {
            VOBC_STATUS_SUPERVISION_EMERGENCY
        } else if self.authorised {
            VOBC_STATUS_SUPERVISION_NOMINAL
        } else {
            VOBC_STATUS_SUPERVISION_NO_AUTHORITY
        }
    }

    fn mode(&self) -> u16 {
        if self.authorised { VOBC_MODE_MODE_AUTHORISED } else { VOBC_MODE_MODE_STANDBY }
    }

    fn send_commands(&mut self, frames: &mut Vec<CanFrame>) {
        let operating = [VOBC_STATUS_ATO_PHASE_RUNNING, VOBC_STATUS_ATO_PHASE_APPROACHING];
        let driving = !self.emergency && operating.contains(&self.phase);
        let accel_mps2 = if driving { self.accel_mps2 } else { -HOLD_MPS2 };
        let pulls = driving && accel_mps2 > 0.0;
        let (left, right) = (self.opens(true), self.opens(false));
        let brake = BRAKE_CMD {
            service_decel_mps2: if self.emergency { BRAKE_MAX_MPS2 } else { (-accel_mps2).max(0.0) },
            emergency_released: !self.emergency,
            holding_released: driving,
        };
        let traction = TRACTION_CMD {
            force_n: if pulls { accel_mps2 * self.settings.mass_kg } else { 0.0 },
            direction: TRACTION_CMD_DIRECTION_FORWARD,
            traction_permitted: pulls,
        };
        let doors = DOOR_CMD {
            enable_left: left,
            enable_right: right,
            open_left: left,
            open_right: right,
        };
        add(frames, self.outputs.brake.send(&brake));
        add(frames, self.outputs.traction.send(&traction));
        if self.cycles % 2 == 0 {
            add(frames, self.outputs.doors.send(&doors));
        }
    }

    fn send_state(&mut self, frames: &mut Vec<CanFrame>) {
        let end_m = self.radio.authority.as_ref().map_or(0.0, |held| held.end_m);
        let status = VOBC_STATUS {
            supervision: self.supervision(),
            ato_phase: self.phase,
            missing: if self.authorised { 0 } else { VOBC_STATUS_MISSING_AUTHORITY },
            localised: self.localised(),
            ..Default::default()
        };
        let motion = VOBC_MOTION {
            speed_mps: self.speed_mps,
            ceiling_mps: self.ceiling_mps,
            emergency_mps: self.ceiling_mps + EMERGENCY_MPS,
        };
        let mode = VOBC_MODE {
            mode: self.mode(),
            cause: self.cause,
            replicas_agree: true, // There is one computation only.
            speed_reach_mps: SPEED_REACH_MPS,
            ..Default::default()
        };
        let uncertainty_m = self.bound_m + self.lag_m;
        let position = VOBC_POSITION { front_m: self.front_m, uncertainty_m };
        let target = VOBC_TARGET {
            distance_to_stop_m: self.to_stop_m(),
            distance_to_authority_m: end_m - (self.front_m + self.bound_m),
        };
        add(frames, self.outputs.status.send(&status));
        if self.cycles % 2 == 0 {
            add(frames, self.outputs.motion.send(&motion));
            add(frames, self.outputs.mode.send(&mode));
            add(frames, self.outputs.position.send(&position));
        }
        if self.cycles % 4 == 0 {
            add(frames, self.outputs.target.send(&target));
        }
    }

    /// Decide, once a cycle. Return the frames to send now.
    pub fn cycle(&mut self, now_ns: i64) -> Vec<CanFrame> {
        let age_ns = self.pulses.map_or(0, |_| now_ns - self.sampled_ns);
        let age_s = age_ns as f64 / 1e9;
        self.lag_m = self.speed_mps.abs() * age_s;
        let fresh = self.supervise(now_ns);
        self.operate(fresh);
        let mut frames = Vec::new();
        self.send_commands(&mut frames);
        self.send_state(&mut frames);
        self.cycles += 1;
        frames
    }

    /// Position report for the wayside; None while the place is unknown.
    pub fn report(&mut self, now_ns: i64) -> Option<Vec<u8>> {
        let (low_m, high_m) = (self.front_m - self.bound_m, self.front_m + self.bound_m);
        let places = [low_m, high_m + self.lag_m, low_m - self.settings.length_m, self.speed_mps];
        let standing = self.stands();
        self.localised().then(|| self.radio.report(now_ns, places, standing))
    }

    /// Status for centre and platforms.
    pub fn status(&mut self, now_ns: i64) -> Vec<u8> {
        let (desk, alarms) = (&self.inputs.desk, &self.inputs.alarms);
        let alarm = desk.received_ns.is_some() && !desk.values.no_passenger_alarm;
        let fire = alarms.received_ns.is_some() && !alarms.values.no_fire;
        let obstacle = alarms.received_ns.is_some() && !alarms.values.no_obstacle;
        let numbers = [self.mode(), self.supervision(), self.cause];
        let mut fields: Vec<Value> = numbers.map(|each| Value::Int(u64::from(each))).into();
        fields.extend([self.localised(), self.stands()].map(Value::Bool));
        fields.push(Value::Float(self.front_m));
        let locked = self.inputs.doors.values.closed_and_locked;
        fields.extend([locked, self.opens(true), self.opens(false)].map(Value::Bool));
        fields.extend([alarm, fire, obstacle, alarm || fire || obstacle].map(Value::Bool));
        fields.push(Value::Int(self.emergencies));
        self.radio.status(now_ns, fields)
    }
}

/// The counter has 16 bits. Half its range is far more than a train moves between two readings.
fn steps_between(first: u16, last: u16) -> i16 {
    last.wrapping_sub(first) as i16
}

fn add(frames: &mut Vec<CanFrame>, (sent, count): ([CanFrame; 2], usize)) {
    frames.extend(&sent[..count]);
}
