//! Present images of a sensor on their way to a window, which is a process of its own.
//!
//! The sensor's thread leaves its newest frame in a [`LiveView`] and goes on. A thread of the view writes it to the window; a frame that
//! comes sooner replaces the one that was not written. A message is a line of JSON and the pixels that it announces.

use std::io::{self, BufRead, Read as _, Write};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use image::RgbImage;
use serde::{Deserialize, Serialize};

/// Longest line of a message, bytes.
const LONGEST_LINE: u64 = 1 << 20;
/// Longest side of a picture, pixels.
const LONGEST_SIDE: u32 = 8192;
/// Most pictures of a message.
const MOST_PICTURES: usize = 16;

/// Pictures and figures of one instant.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LiveFrame {
    /// Pictures with their captions, from left to right.
    pub pictures: Vec<(String, RgbImage)>,
    /// Names, values and units of figures.
    pub figures: Vec<(String, String)>,
}

/// Why no more frames come.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LiveEnd {
    /// All were shown, in words.
    Complete(String),
    /// The sensor was lost, in words.
    Trouble(String),
    /// The program is asked to end, and the window closes.
    Closing,
}

/// A message from a sensor to its window.
#[derive(Debug, Clone, PartialEq)]
pub enum LiveMessage {
    /// Its newest frame.
    Frame(LiveFrame),
    /// No more frames come.
    End(LiveEnd),
}

/// The line that begins a message.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Head {
    Frame {
        /// Captions, widths and heights of pictures, whose bytes follow the line.
        pictures: Vec<(String, u32, u32)>,
        figures: Vec<(String, String)>,
    },
    End(LiveEnd),
}

impl LiveMessage {
    /// Writes the message.
    ///
    /// # Errors
    /// If the other side is gone.
    pub fn write(&self, to: &mut impl Write) -> io::Result<()> {
        let head = match self {
            Self::Frame(frame) => {
                let size =
                    |(caption, picture): &(String, RgbImage)| (caption.clone(), picture.width(), picture.height());
                Head::Frame { pictures: frame.pictures.iter().map(size).collect(), figures: frame.figures.clone() }
            }
            Self::End(end) => Head::End(end.clone()),
        };
        serde_json::to_writer(&mut *to, &head)?;
        to.write_all(b"\n")?;
        if let Self::Frame(frame) = self {
            frame.pictures.iter().try_for_each(|(_, picture)| to.write_all(picture.as_raw()))?;
        }
        to.flush()
    }

    /// Reads a message, or `None` at the end.
    ///
    /// # Errors
    /// If the bytes are no message, or end within one.
    pub fn read(from: &mut impl BufRead) -> io::Result<Option<Self>> {
        let mut line = Vec::new();
        from.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line)?;
        if line.is_empty() {
            return Ok(None);
        }
        let (sizes, figures) = match serde_json::from_slice(&line)? {
            Head::End(end) => return Ok(Some(Self::End(end))),
            Head::Frame { pictures, figures } => (pictures, figures),
        };
        let invalid = || io::Error::from(io::ErrorKind::InvalidData);
        if sizes.len() > MOST_PICTURES || sizes.iter().any(|&(_, width, height)| width.max(height) > LONGEST_SIDE) {
            return Err(invalid());
        }
        let mut pictures = Vec::with_capacity(sizes.len());
        for (caption, width, height) in sizes {
            let mut pixels = Vec::new();
            from.by_ref().take(3 * u64::from(width) * u64::from(height)).read_to_end(&mut pixels)?;
            pictures.push((caption, RgbImage::from_raw(width, height, pixels).ok_or_else(invalid)?));
        }
        Ok(Some(Self::Frame(LiveFrame { pictures, figures })))
    }
}

/// The sensor's side of a window.
#[derive(Debug, Clone, Default)]
pub struct LiveView {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    news: Mutex<News>,
    has_news: Condvar,
}

#[derive(Debug, Default)]
struct News {
    frame: Option<LiveFrame>,
    end: Option<LiveEnd>,
}

impl LiveView {
    /// Shows a frame as soon as the window takes it. Never waits for the window.
    pub fn show(&self, frame: LiveFrame) {
        self.news().frame = Some(frame);
        self.shared.has_news.notify_one();
    }

    /// Tells the window that no more frames come.
    pub fn end(&self, end: LiveEnd) {
        self.news().end = Some(end);
        self.shared.has_news.notify_one();
    }

    fn news(&self) -> MutexGuard<'_, News> {
        self.shared.news.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes what is shown to the window until the end, or until the window is gone.
    pub fn write_to(&self, window: &mut impl Write) {
        loop {
            let mut news = self.news();
            while news.frame.is_none() && news.end.is_none() {
                news = self.shared.has_news.wait(news).unwrap_or_else(PoisonError::into_inner);
            }
            let (frame, end) = (news.frame.take(), news.end.take());
            drop(news);
            let has_ended = end.is_some();
            let messages = frame.map(LiveMessage::Frame).into_iter().chain(end.map(LiveMessage::End));
            // A window that is gone says so by the end of its process.
            if messages.into_iter().any(|message| message.write(window).is_err()) || has_ended {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn frame(level: u8) -> LiveFrame {
        let pictures = [(24, 32), (5, 0)].map(|(width, height)| {
            (format!("{width} wide"), RgbImage::from_pixel(width, height, Rgb([level, b'\n', 1])))
        });
        LiveFrame { pictures: pictures.into(), figures: vec![("area".to_owned(), format!("{level} mm²"))] }
    }

    #[test]
    fn messages_arrive_as_they_were_sent() {
        let sent = [
            LiveMessage::Frame(frame(10)),
            LiveMessage::Frame(LiveFrame::default()),
            LiveMessage::End(LiveEnd::Trouble("it is \"gone\"\n".to_owned())),
            LiveMessage::End(LiveEnd::Closing),
        ];
        let mut bytes = Vec::new();
        sent.iter().for_each(|message| message.write(&mut bytes).unwrap());
        let mut rest = bytes.as_slice();
        for message in sent {
            assert_eq!(LiveMessage::read(&mut rest).unwrap(), Some(message));
        }
        assert_eq!(LiveMessage::read(&mut rest).unwrap(), None);
        // A process that ends within a message, and one that speaks another language.
        assert!(LiveMessage::read(&mut &bytes[..200]).is_err());
        assert!(
            LiveMessage::read(&mut "{\"frame\":{\"pictures\":[[\"\",99999,1]],\"figures\":[]}}\n".as_bytes()).is_err()
        );
        assert!(LiveMessage::read(&mut "hello\n".as_bytes()).is_err());
    }

    #[test]
    fn a_frame_that_was_not_taken_is_replaced() {
        let view = LiveView::default();
        [10, 20, 30].into_iter().for_each(|level| view.show(frame(level)));
        view.end(LiveEnd::Closing);
        let mut bytes = Vec::new();
        view.write_to(&mut bytes);
        let mut rest = bytes.as_slice();
        assert_eq!(LiveMessage::read(&mut rest).unwrap(), Some(LiveMessage::Frame(frame(30))));
        assert_eq!(LiveMessage::read(&mut rest).unwrap(), Some(LiveMessage::End(LiveEnd::Closing)));
        assert!(rest.is_empty());
    }
}
