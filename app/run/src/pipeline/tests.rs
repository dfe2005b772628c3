use super::*;
use crate::source::Pictures;
use mvt_robot::hand::Hand;
use mvt_robot::observation::Percept;

/// Remembers in which order it was asked and directed.
struct Witness {
    hand: Arc<Hand>,
    asked: Vec<String>,
    frames: u64,
}

const FRAMES: u64 = 5;

impl Default for Witness {
    fn default() -> Self {
        Self { hand: Hand::none(), asked: Vec::new(), frames: 0 }
    }
}

impl Source for Witness {
    fn next(&mut self) -> Frame {
        self.asked.push(format!("frame {}", self.frames));
        if self.frames == FRAMES {
            return Ok(None);
        }
        let frame = self.frames;
        self.frames += 1;
        let time_s = frame as f64;
        let percept = Percept { time_s, joints: Vec::new(), cameras: vec![], touch: Default::default() };
        Ok(Some(Sensed {
            frame,
            percept,
            truth: None,
            carried: None,
            pictures: Pictures::default(),
            sense_ms: 0.0,
            hidden: None,
            warnings: vec![],
            events: vec![],
        }))
    }

    fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }

    fn direct(&mut self, directive: Directive) -> Result<()> {
        self.asked.push(format!("{directive:?}"));
        Ok(())
    }

    fn frame_count(&self) -> usize {
        FRAMES as usize
    }

    fn end(&self) -> (String, bool) {
        (String::new(), true)
    }

    fn calibration(&self) -> Option<mvt_calibration::Calibration> {
        None
    }
}

/// A directive that tells after which frame it was given.
fn after(frame: u64) -> Directive {
    Directive::Recentre { offset_m: [frame as f64, 0.0] }
}

fn consume(mut feed: Feed<'_>) -> Vec<u64> {
    let mut frames = Vec::new();
    while let Some(sensed) = feed.next().unwrap() {
        frames.push(sensed.frame);
        feed.order(Order { directive: after(sensed.frame), place: None }).unwrap();
    }
    frames
}

#[test]
fn a_directive_takes_effect_two_frames_later_with_any_number_of_threads() {
    let mut inline = Witness::default();
    let frames = consume(Feed::Inline { source: &mut inline, ahead: VecDeque::new(), ended: false });
    assert_eq!(frames, [0, 1, 2, 3, 4]);
    let mut expected = vec!["frame 0".to_owned(), "frame 1".to_owned()];
    for k in 2..=FRAMES {
        expected.extend([format!("{:?}", after(k - 2)), format!("frame {k}")]);
    }
    // A directive after the last frames reaches nothing.
    assert_eq!(inline.asked[..expected.len()], expected);

    let mut threaded = Witness::default();
    thread::scope(|scope| {
        let (sender, frames) = mpsc::sync_channel(AHEAD);
        let (directives, receiver) = mpsc::channel();
        let source = &mut threaded;
        scope.spawn(move || serve(source, &sender, &receiver));
        assert_eq!(consume(Feed::Threaded { frames, directives }), [0, 1, 2, 3, 4]);
    });
    assert_eq!(threaded.asked, expected);
}

#[test]
fn a_start_near_the_truth_is_a_centimetre_and_ten_degrees_away() {
    let truth = Isometry::from_parts([0.1, 0.2, 0.3], [0.5, 0.5, -0.5, 0.5]);
    let of_seed = |seed| Init::Near.start(truth, seed).unwrap().untyped();
    for seed in 0..20 {
        let change = truth.untyped().inverse() * of_seed(seed);
        assert!((change.translation.vector.norm() - 0.01).abs() < 1e-12);
        assert!((change.rotation.angle().to_degrees() - 10.0).abs() < 1e-9);
        assert_eq!(of_seed(seed), of_seed(seed));
        assert_ne!(of_seed(seed), of_seed(seed + 1));
    }
    assert_eq!(Init::Truth.start(truth, 0).unwrap().untyped(), truth.untyped());
    assert!(Init::Search.start(truth, 0).is_none());
}
