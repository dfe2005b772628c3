use crate::{SettingError, SettingGroup as _, SettingInfo};

crate::settings! {
    /// Settings of all kinds.
    #[derive(Copy)]
    pub struct Inner {
        /// A count.
        pub count: usize = 3, 1..=20;
        /// A share,
        /// in two lines.
        pub share: f32 = 0.1, 1e-6..=1.0;
        /// A pair.
        pub pair: [f64; 2] = [0.0, 1.0], -1.0..=1.0;
    }
    rule = count_exceeds_pair;
}

crate::settings! {
    /// Settings with others inside.
    pub struct Outer {
        /// A list.
        pub list: Vec<u32> = vec![8, 20], List { length: 1..=3, each: 2..=1024 };
        /// A multiple.
        pub multiple: usize = 32, Multiple { of: 16, within: 16..=256 };
        /// A switch.
        #[serde(skip_serializing_if = "std::ops::Not::not")]
        pub switch: bool;
        /// A name.
        pub name: String = "x".to_owned();
        /// The others.
        pub inner: Inner, Nested;
    }
}

fn count_exceeds_pair(inner: &Inner) -> Result<(), SettingError> {
    if inner.count as f64 > inner.pair[0] {
        return Ok(());
    }
    Err(SettingError::new("count", inner.count.to_string(), "more than pair[0]"))
}

fn refused(change: impl Fn(&mut Outer)) -> String {
    let mut outer = Outer::default();
    change(&mut outer);
    outer.validate().unwrap_err().to_string()
}

#[test]
fn the_first_setting_out_of_range_is_named_with_its_path() {
    Outer::default().validate().unwrap();
    Inner::default().validate().unwrap();
    assert_eq!(refused(|o| o.inner.count = 0), "inner.count must be from 1 to 20 (it is 0)");
    assert_eq!(refused(|o| o.inner.count = 21), "inner.count must be from 1 to 20 (it is 21)");
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 0.0, 1.5, 1e30] {
        let message = refused(|o| o.inner.share = value);
        assert!(message.starts_with("inner.share must be from 1e-6 to 1 (it is "), "{message}");
    }
    assert!(refused(|o| o.inner.share = 1e30).ends_with("(it is 1e30)"));
    assert_eq!(
        refused(|o| o.inner.pair[1] = f64::NAN),
        "inner.pair must be 2 numbers, each from -1 to 1 (it is [0, NaN])"
    );
    for list in [vec![], vec![8, 1], vec![2000], vec![8; 4]] {
        let message = refused(|o| o.list.clone_from(&list));
        assert!(message.starts_with("list must be 1 to 3 numbers, each from 2 to 1024 (it is ["), "{message}");
    }
    for multiple in [0, 17, 512] {
        assert!(refused(|o| o.multiple = multiple).starts_with("multiple must be a multiple of 16 from 16 to 256"));
    }
}

#[test]
fn rules_between_fields_are_checked_after_ranges() {
    crate::settings! {
        /// A pair alone.
        pub struct Strict {
            /// A number.
            pub number: f64 = 0.5, 0.0..=1.0;
        }
        rule = refuse_all;
    }
    fn refuse_all(_: &Strict) -> Result<(), SettingError> {
        Err(SettingError::new("number", "0.5", "another"))
    }
    assert_eq!(Strict { number: 2.0 }.validate().unwrap_err().range, "from 0 to 1");
    assert_eq!(Strict::default().validate().unwrap_err().range, "another");
}

#[test]
fn the_listing_has_every_key_with_documentation_default_and_range() {
    let texts = |get: fn(SettingInfo) -> String| Outer::listing().into_iter().map(get).collect::<Vec<_>>();
    assert_eq!(texts(|s| s.key), ["list", "multiple", "switch", "name", "inner.count", "inner.share", "inner.pair"]);
    assert_eq!(texts(|s| s.doc)[4..6], ["A count.", "A share,\nin two lines."]);
    assert_eq!(texts(|s| s.doc)[2], "A switch.");
    assert_eq!(texts(|s| s.default), ["[8, 20]", "32", "false", "\"x\"", "3", "0.1", "[0, 1]"]);
    assert_eq!(texts(|s| s.range)[2..], ["", "", "from 1 to 20", "from 1e-6 to 1", "2 numbers, each from -1 to 1"]);
    let bounds: Vec<_> = Outer::listing().iter().map(|s| s.bounds.is_some()).collect();
    assert_eq!(bounds, [true, true, false, false, true, true, true]);
}

#[test]
fn missing_keys_get_defaults_and_unknown_keys_are_refused() {
    let outer: Outer = toml::from_str("multiple = 64\n[inner]\ncount = 7\n").unwrap();
    let inner = Inner { count: 7, ..Inner::default() };
    assert_eq!(outer, Outer { multiple: 64, inner, ..Outer::default() });
    assert_eq!(toml::from_str::<Outer>(&toml::to_string(&outer).unwrap()).unwrap(), outer);
    assert!(!toml::to_string(&outer).unwrap().contains("switch"));
    assert!(toml::from_str::<Outer>("[inner]\ncuont = 7\n").unwrap_err().to_string().contains("cuont"));
}
