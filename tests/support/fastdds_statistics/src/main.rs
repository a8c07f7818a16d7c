//! Listener for the statistics topics of Fast DDS: `fastdds-statistics DOMAIN`, until it is ended.
//!
//! Prints `ready`, then a line `TOPIC ENTITY COUNT` for each sample: ENTITY is the id of a writer or reader, 8 hex digits, COUNT
//! what it has counted since it began. Written with RustDDS, because the wheels of Fast DDS have no interface to these topics.

use std::{env, io::Write, thread, time::Duration};

use rustdds::{
    policy::{Durability, Reliability},
    with_key::Sample,
    DomainParticipant, Keyed, QosPolicyBuilder, TopicKind, GUID,
};
use serde::{Deserialize, Serialize};

const TOPICS: [&str; 2] = ["resent_datas", "heartbeat_count"];

#[derive(Clone, Debug, Deserialize, Serialize)]
struct EntityCount {
    guid: GUID,
    count: u64,
}

impl Keyed for EntityCount {
    type K = GUID;

    fn key(&self) -> GUID {
        self.guid
    }
}

fn main() {
    let domain: u16 = env::args().nth(1).expect("DOMAIN").parse().expect("a domain id");
    let participant = DomainParticipant::new(domain).expect("participant");
    let qos = QosPolicyBuilder::new()
        .reliability(Reliability::Reliable { max_blocking_time: rustdds::Duration::from_secs(1) })
        .durability(Durability::TransientLocal)
        .build();
    let subscriber = participant.create_subscriber(&qos).expect("subscriber");
    let mut readers: Vec<_> = TOPICS
        .iter()
        .map(|name| {
            let topic = participant
                .create_topic(
                    format!("_fastdds_statistics_{name}"),
                    "eprosima::fastdds::statistics::EntityCount".to_string(),
                    &qos,
                    TopicKind::WithKey,
                )
                .expect("topic");
            (name, subscriber.create_datareader_cdr::<EntityCount>(&topic, None).expect("reader"))
        })
        .collect();
    let mut out = std::io::stdout();
    writeln!(out, "ready").expect("stdout");
    out.flush().expect("stdout");
    loop {
        for (name, reader) in &mut readers {
            while let Ok(Some(sample)) = reader.take_next_sample() {
                if let Sample::Value(said) = sample.into_value() {
                    let entity = said.guid.entity_id;
                    let [a, b, c] = entity.entity_key;
                    let kind = u8::from(entity.entity_kind);
                    writeln!(out, "{name} {a:02x}{b:02x}{c:02x}{kind:02x} {}", said.count).expect("stdout");
                }
            }
        }
        out.flush().expect("stdout");
        thread::sleep(Duration::from_millis(50));
    }
}
