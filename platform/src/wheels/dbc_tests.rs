#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
use super::*;
use miette::Diagnostic;

const DBC: &str = concat!(
    "VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: ABS\n\n",
    "BO_ 903 PULSES: 6 ABS\n",
    " SG_ FL : 0|8@1+ (0.5,0) [0|127.5] \"count\" ABS\n",
    " SG_ FR : 8|8@1+ (0.5,0) [0|127.5] \"count\" ABS\n",
    " SG_ RL : 16|8@1+ (0.5,0) [0|127.5] \"count\" ABS\n",
    " SG_ RR : 24|8@1+ (0.5,0) [0|127.5] \"count\" ABS\n",
    " SG_ DIR_FL : 32|2@1+ (1,0) [0|3] \"\" ABS\n",
    " SG_ DIR_FR : 34|2@1+ (1,0) [0|3] \"\" ABS\n",
    " SG_ DIR_RL : 36|2@1+ (1,0) [0|3] \"\" ABS\n",
    " SG_ DIR_RR : 38|2@1+ (1,0) [0|3] \"\" ABS\n\n",
    "BO_ 170 SPEEDS: 8 ABS\n",
    " SG_ V_FR_FAULT : 7|1@0+ (1,0) [0|0] \"\" ABS\n",
    " SG_ V_FR : 6|15@0+ (0.01,-67.67) [0|200] \"km/h\" ABS\n",
    " SG_ V_FL : 22|15@0+ (0.01,-67.67) [0|200] \"km/h\" ABS\n",
    " SG_ V_RR : 38|15@0+ (0.01,-67.67) [0|200] \"km/h\" ABS\n",
    " SG_ V_RL : 54|15@0+ (0.01,-67.67) [0|200] \"km/h\" ABS\n\n",
    "BO_ 2566848533 SIGNED: 8 ABS\n",
    " SG_ S_FL : 4|12@1- (0.1,0) [0|0] \"m/s\" ABS\n",
    " SG_ S_FR : 16|12@1- (0.1,0) [0|0] \"m/s\" ABS\n",
    " SG_ S_RL : 28|12@1- (0.1,0) [0|0] \"furlong\" ABS\n",
    " SG_ S_RR : 40|12@1- (0.1,0) [0|0] \"m/s\" ABS\n",
);

fn decoder(mapping: &str) -> Result<WheelDecoder, MappingError> {
    let mapping: WheelMapping = toml::from_str(mapping).unwrap();
    WheelDecoder::new(Path::new("car.dbc"), DBC, &mapping)
}

const PULSES: &str = r#"message = "PULSES"
kind = "counts"
signals = ["FL", "FR", "RL", "RR"]
directions = ["DIR_FL", "DIR_FR", "DIR_RL", "DIR_RR"]"#;
const SPEEDS: &str = r#"message = "SPEEDS"
kind = "speeds"
signals = ["V_FL", "V_FR", "V_RL", "V_RR"]
faults = ["V_FR_FAULT", "V_FR_FAULT", "V_FR_FAULT", "V_FR_FAULT"]"#;

#[test]
fn counters_stay_raw_and_directions_are_signs() {
    let mut decoder = decoder(PULSES).unwrap();
    let data = [0xfe, 0x01, 0x80, 0x7f, 0b0011_1001, 0];
    let stamp = Micros(5);
    let reading = decoder.decode(903, false, &data, stamp).unwrap().unwrap();
    let expected = WheelReading::Counts {
        stamp,
        counts: [254, 1, 128, 127],
        direction: [1, -1, 0, 0],
    };
    assert_eq!(reading, expected);
    assert_eq!(decoder.counter_modulus(), Some(256));
    assert!(decoder.decode(903, true, &data, stamp).is_none());
    assert!(decoder.decode(904, false, &data, stamp).is_none());
    assert_eq!(
        decoder.decode(903, false, &data[..4], stamp),
        Some(Err(DecodeFault::Short))
    );
    assert_eq!(
        decoder.decode(903, false, &[], stamp),
        Some(Err(DecodeFault::Short))
    );
}

#[test]
fn big_endian_speeds_are_metres_a_second_in_the_order_of_the_wheels() {
    let mut decoder = decoder(SPEEDS).unwrap();
    let data = [0x25, 0xb5, 0x25, 0xb6, 0x25, 0xa0, 0x25, 0x8d];
    let Some(Ok(WheelReading::Speeds { mps, .. })) = decoder.decode(170, false, &data, Micros(0)) else {
        panic!("no speeds");
    };
    for (found, raw) in mps.iter().zip([0x25b6, 0x25b5, 0x258d, 0x25a0]) {
        let expected = (f64::from(raw) * 0.01 - 67.67) / 3.6;
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
    let mut flagged = data;
    flagged[0] |= 0x80;
    assert_eq!(
        decoder.decode(170, false, &flagged, Micros(0)),
        Some(Err(DecodeFault::Flagged))
    );
    let mut absent = data;
    (absent[2], absent[3]) = (0x7f, 0xff);
    assert_eq!(
        decoder.decode(170, false, &absent, Micros(0)),
        Some(Err(DecodeFault::OutOfRange))
    );
}

#[test]
fn signed_little_endian_speeds_of_an_extended_message_roll_back() {
    let mapping = "message = \"SIGNED\"\nkind = \"speeds\"\nunit = \"m/s\"\nsignals = [\"S_FL\", \"S_FR\", \"S_RL\", \"S_RR\"]";
    let mut decoder = decoder(mapping).unwrap();
    assert_eq!(decoder.id(), (0x18ff_0015, true));
    // -1, 2047, -2048, 0 in twelve bits each, from bit 4.
    let bits: u64 = 0xfff << 4 | 0x7ff << 16 | 0x800 << 28;
    let reading = decoder
        .decode(0x18ff_0015, true, &bits.to_le_bytes(), Micros(0))
        .unwrap()
        .unwrap();
    let WheelReading::Speeds { mps, .. } = reading else {
        panic!("no speeds")
    };
    for (found, expected) in mps.iter().zip([-0.1, 204.7, -204.8, 0.0]) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
}

#[test]
fn damaged_and_repeated_messages_are_no_readings() {
    let dbc = DBC.replace(
        "BO_ 170 SPEEDS",
        " SG_ SUM : 40|8@1+ (1,0) [0|255] \"\" ABS\n\nBO_ 170 SPEEDS",
    );
    let dbc = dbc.replace(
        " SG_ DIR_RR : 38|2",
        " SG_ ALIVE : 32|2@1+ (1,0) [0|2] \"\" ABS\n SG_ DIR_RR : 38|2",
    );
    let text = "message = \"PULSES\"\nkind = \"counts\"\nsignals = [\"FL\", \"FR\", \"RL\", \"RR\"]\n\
        counter = \"ALIVE\"\nchecksum = { signal = \"SUM\", algorithm = \"xor\" }";
    let decoder = |text: &str| WheelDecoder::new(Path::new("car.dbc"), &dbc, &toml::from_str(text).unwrap());
    let mut checked = decoder(text).unwrap();
    let mut decode = |data: [u8; 6]| {
        let decoded = checked.decode(903, false, &data, Micros(0)).unwrap();
        decoded.map(|_| ())
    };
    assert_eq!(decode([1, 0, 0, 0, 0, 1]), Ok(()));
    assert_eq!(decode([1, 0, 0, 0, 1, 1]), Err(DecodeFault::Checksum));
    assert_eq!(decode([1, 0, 0, 0, 0, 1]), Err(DecodeFault::CounterStuck));
    assert_eq!(decode([1, 0, 0, 0, 1, 0]), Ok(()));
    assert_eq!(decode([1, 0, 0, 0, 2, 3]), Ok(()));
    assert_eq!(
        decode([1, 0, 0, 0, 0, 1]),
        Ok(()),
        "wraps behind 2, as the DBC says"
    );
    for (wrong, cause) in [
        (text.replace("\"SUM\"", "\"ALIVE\""), "no whole byte"),
        (
            text.replace("xor", "toyota").replace("\"SUM\"", "\"RR\""),
            "not the last",
        ),
        (text.replace("\"ALIVE\"", "\"ALIV\""), "no signal ALIV"),
    ] {
        let error = decoder(&wrong).unwrap_err().to_string();
        assert!(error.contains(cause), "{error}");
    }
}

#[test]
fn a_wrong_mapping_names_the_file_the_name_and_its_likes() {
    let cases = [
        (
            PULSES.replace("\"PULSES\"", "\"PULSE\""),
            "no message PULSE; messages like it: PULSES",
            "message",
        ),
        (
            SPEEDS.replace("V_RL", "V_LR"),
            "no signal V_LR; its signals: V_FR",
            "SPEEDS",
        ),
        (
            SPEEDS
                .replace("speeds", "counts")
                .replace("SPEEDS", "SIGNED")
                .replace("V_", "S_")
                .replace("faults", "#"),
            "unsigned",
            "speeds",
        ),
        (PULSES.replace("counts", "speeds"), "unit \"count\"", "km/h"),
        (
            SPEEDS
                .replace("SPEEDS", "SIGNED")
                .replace("V_", "S_")
                .replace("faults", "#"),
            "different units",
            "km/h",
        ),
    ];
    for (mapping, cause, fix) in cases {
        let error = decoder(&mapping).unwrap_err();
        let message = error.to_string();
        assert!(
            message.starts_with("car.dbc: ") && message.contains(cause),
            "{message}"
        );
        assert!(error.help().unwrap().to_string().contains(fix), "{message}");
    }
    let mapping: WheelMapping = toml::from_str(PULSES).unwrap();
    let error = WheelDecoder::new(Path::new("car.dbc"), "no DBC at all", &mapping).unwrap_err();
    assert!(matches!(error, MappingError::Syntax { .. }), "{error}");
    assert!(toml::from_str::<WheelMapping>(&format!("{PULSES}\nsignal = 1")).is_err());
}
