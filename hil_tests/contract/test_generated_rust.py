"""The generated Rust and the codec agree on every frame and every damage."""

import random
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from can_dbc import c_source, rust_source
from can_dbc.binding import Binding
from can_dbc.codec import Decoder, Encoder, Rejected
from hil_tests.native_rig import code_in
from hil_tests.wire_traffic import damaged, sampled_frame
from hil_tests.wire_verdicts import VERDICTS

STEPS = 40
SHIPPED = c_source.shipped_bindings()
MAIN = """
mod wire;
use wire::*;

fn send<T: Values>(sender: &mut Sender<T>, values: T) {
    let (frames, count) = sender.send(&values);
    for frame in &frames[..count] {
        print!("{}:", frame.id);
        for byte in &frame.data[..frame.length as usize] {
            print!("{:02x}", byte);
        }
        print!(" ");
    }
    println!();
}

fn main() {
    let mut lines = std::io::stdin().lines().map(|line| line.unwrap());
    while let Some(name) = lines.next() {
        match name.as_str() {
            CASES
            _ => panic!("{}", name),
        }
    }
}
"""
CASE = """
"NAME" => {
    let (mut sender, mut receiver) = (Sender::<NAME>::new(), Receiver::<NAME>::new());
    while let Some(line) = lines.next() {
        let words: Vec<&str> = line.split(' ').collect();
        match words[0] {
            "send" => {
                let n: Vec<f64> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
                send(&mut sender, NAME { MAKE });
            }
            "receive" => {
                let mut frame = CanFrame { id: words[1].parse().unwrap(), ..Default::default() };
                frame.length = (words[3].len() / 2) as u8;
                for at in 0..frame.length as usize {
                    let byte = &words[3][2 * at..2 * at + 2];
                    frame.data[at] = u8::from_str_radix(byte, 16).unwrap();
                }
                let verdict = receiver.receive(&frame, words[2].parse().unwrap());
                let v = receiver.values;
                let _ = v;
                print!("{}", verdict as u8);
                SHOW
                println!();
            }
            _ => break,
        }
    }
}
"""


def program_of(bound: list[Binding]) -> str:
    """A program that sends and receives as the lines of its input say."""
    cases = []
    for each in bound:
        make, show = [], []
        for at, field in enumerate(each.fields):
            name = f"r#{field.name}"
            kind = rust_source.TYPES.get(field.kind, "u16")
            make.append(
                f"{name}: n[{at}] != 0.0" if kind == "bool" else f"{name}: n[{at}] as {kind}"
            )
            show.append(f'print!(" {{:?}}", v.{name}{" as u8" if kind == "bool" else ""} as f64);')
        case = CASE.replace("NAME", each.message.name)
        cases.append(case.replace("MAKE", ", ".join(make)).replace("SHOW", " ".join(show)))
    return MAIN.replace("CASES", "\n".join(cases))


def numbers_of(bound: Binding, frame: Any) -> list[float]:
    return [float(getattr(frame, field.name)) for field in bound.fields]


def talk(bound: Binding, bits: random.Random) -> Iterator[tuple[str, str]]:
    """Yield lines for the program, each with the answer by the codec."""
    name = bound.message.name
    encoder, decoder = Encoder([bound.kind]), Decoder([bound.kind])
    yield name, ""
    for _ in range(STEPS):
        frame = sampled_frame(bound.kind, bits)
        sent = [f"{can_id}:{data.hex()} " for can_id, data in encoder.encode(frame)]
        yield " ".join(["send", *map(repr, numbers_of(bound, frame))]), "".join(sent)
    values = [0.0] * len(bound.fields)
    for can_id, data, at_ns in damaged(bound.kind, bits, STEPS):
        if len(data) > 8:
            continue  # No classic frame.
        found = decoder.decode(can_id, data, at_ns)
        if found is not None and not isinstance(found, Rejected):
            values = numbers_of(bound, found)
        verdict = found.reason.name if isinstance(found, Rejected) else str(int(found is None))
        yield f"receive {can_id} {at_ns} {data.hex()}", " ".join([verdict, *map(repr, values)])
    yield "end", ""


def as_reason(answer: str) -> str:
    """Replace the number of a verdict that rejects a frame by the codec's reason."""
    verdict, blank, rest = answer.partition(" ")
    reason = VERDICTS.get(int(verdict)) if verdict.isdigit() else None
    return answer if reason is None else f"{reason.name}{blank}{rest}"


def test_the_generated_rust_agrees(tmp_path: Path, rust_compiler: str) -> None:
    for name, text in rust_source.wire_files(SHIPPED).items():
        (tmp_path / name).write_text(text)
    (tmp_path / "main.rs").write_text(program_of(SHIPPED))
    flags = ["--edition", "2021", "-D", "warnings", "-C", "opt-level=0"]
    command = [rust_compiler, *flags, str(tmp_path / "main.rs"), "-o", str(tmp_path / "main")]
    subprocess.run(command, check=True)
    with code_in("Python"):
        pairs = [
            pair for bound in SHIPPED for pair in talk(bound, random.Random(bound.message.name))
        ]

    done = subprocess.run(
        [tmp_path / "main"],
        input="".join(f"{line}\n" for line, _ in pairs),
        capture_output=True,
        text=True,
        check=True,
    )

    asked = [(line, answer) for line, answer in pairs if line.startswith(("send", "receive"))]
    for (line, expected), found in zip(asked, done.stdout.splitlines(), strict=True):
        assert (as_reason(found) if line.startswith("receive") else found) == expected, line
