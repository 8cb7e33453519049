//! Runs the controller in lockstep with the bench, which starts this program.

mod controller;
mod lockstep;
mod radio;
mod tags;
mod wire;

use controller::{Controller, Settings, Stop};
use lockstep::{Bench, Json};
use radio::Radio;

const NS_PER_MS: f64 = 1e6;
const START_BOUND_M: f64 = 0.5;

fn settings_of(told: &Json) -> Option<Settings> {
    let (line, params) = (told.get("line"), told.get("params"));
    let station = |name: &str| {
        line.list("stations").iter().find(|each| each.text("name") == Some(name))
    };
    let mut stops = Vec::new();
    for stop in told.get("mission").list("stops") {
        let Json::Text(name) = stop else {
            return None;
        };
        let each = station(name)?;
        stops.push(Stop {
            at_m: each.number("stop_m")?,
            dwell_s: each.number("dwell_s")?,
            left: each.text("side") == Some("left"),
        });
    }
    let limits = line.list("speed_sections").iter();
    let tags = line.list("tags").iter();
    let train = params.get("train");
    let start = station(told.get("mission").text("start")?)?.number("stop_m")?;
    // After a restart the bench says what is known of the place; mostly that it is unknown.
    let standing = told.get("standing");
    Some(Settings {
        start_m: standing.number("front_m").unwrap_or(start),
        start_bound_m: standing.number("bound_m").unwrap_or(START_BOUND_M),
        cycle_s: params.number("cycle_ms")? / 1000.0,
        stops,
        limits: limits
            .map(|each| {
                Some((each.number("start_m")?, each.number("end_m")?, each.number("limit_mps")?))
            })
            .collect::<Option<_>>()?,
        tags: tags
            .map(|each| Some((each.number("tag_id")? as u32, each.number("position_m")?)))
            .collect::<Option<_>>()?,
        length_m: train.number("length_m")?,
        mass_kg: train.number("tare_kg")? * (1.0 + train.number("rotating_mass_ratio")?)
            + 0.5 * train.number("full_load_kg")?,
        m_per_pulse: std::f64::consts::PI * train.number("wheel_diameter_m")?
            / train.number("pulses_per_turn")?,
        antenna_m: train.number("antenna_offset_m")?,
    })
}

fn radio_of(told: &Json) -> Option<Radio> {
    let air = told.get("radio");
    let key = air.text("safety_key")?;
    let byte = |at: usize| u8::from_str_radix(key.get(at..at + 2)?, 16).ok();
    let hex = |name: &str| u64::from_str_radix(air.text(name)?, 16).ok();
    Some(Radio {
        key: (0..key.len()).step_by(2).map(byte).collect::<Option<_>>()?,
        database: hex("database")?,
        parameters: hex("parameters")?,
        train: told.get("params").number("address")? as u16,
        boot: told.get("memory").number("boot_count")? as u64 + 1,
        ..Default::default()
    })
}

fn run(bench: &mut Bench, told: &Json, mut controller: Controller) -> std::io::Result<()> {
    let number = |name: &str| told.get("params").number(name).unwrap_or(200.0);
    let (cycle_ns, period_ns) =
        ((number("cycle_ms") * NS_PER_MS) as i64, (number("report_ms") * NS_PER_MS) as i64);
    let key = |name: &str| told.get("radio").text(name).unwrap_or_default().to_string();
    let (status_key, report_key) = (key("status_key"), key("report_key"));
    let mut next_ns = told.number("start_ns").unwrap_or(0.0) as i64;
    let mut report_ns = next_ns;
    bench.ready("@name@ 0.1", next_ns)?;
    while let Some(grant) = bench.wait()? {
        let now_ns = grant.now_ns;
        if grant.stop {
            return bench.answer(now_ns, now_ns, &[], &[]);
        }
        for (at_ns, frame) in &grant.frames {
            controller.take_frame(frame, *at_ns);
        }
        grant.serial.iter().for_each(|data| controller.take_serial(data));
        grant.radio.iter().for_each(|payload| controller.radio.take(payload, now_ns));
        let frames = controller.cycle(now_ns);
        let mut radio = Vec::new();
        if now_ns >= report_ns {
            report_ns = now_ns + period_ns;
            radio.push((status_key.as_str(), controller.status(now_ns)));
            if let Some(report) = controller.report(now_ns) {
                radio.push((report_key.as_str(), report));
            }
        }
        // The cycles stay on a grid, also where a wake-up is late.
        while next_ns <= now_ns {
            next_ns += cycle_ns;
        }
        bench.answer(now_ns, next_ns, &frames, &radio)?;
    }
    Ok(())
}

fn main() -> std::io::Result<()> {
    let mut bench = Bench::new();
    let Some(hello) = bench.hello()? else {
        eprintln!("the bench starts this program: hil run smoke --controller ...");
        std::process::exit(2);
    };
    let told = hello.get("told");
    match (settings_of(told), radio_of(told)) {
        (Some(settings), Some(radio)) => run(&mut bench, told, Controller::new(settings, radio)),
        _ => bench.refuse("line, mission or train are not as this controller needs them"),
    }
}
