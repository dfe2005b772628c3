//! Work that takes longer than a frame of the window may: a thread that does the newest order, and forgets those that it has not begun.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use eframe::egui::Context;

/// What a studio's thread does.
pub trait Craft: Send + 'static {
    /// What is wanted.
    type Order: Send + Clone + PartialEq + 'static;
    /// What comes of it.
    type Product: Send + 'static;

    /// Does an order.
    fn make(&mut self, order: Self::Order) -> Self::Product;

    /// Called when there is nothing to do: after how long it wants to be called again, if at all, and whether the window should look.
    fn idle(&mut self) -> (Option<Duration>, bool) {
        (None, false)
    }
}

/// A thread with an order and a product.
pub struct Studio<C: Craft> {
    desk: Arc<Desk<C>>,
    last: Option<C::Order>,
}

struct Desk<C: Craft> {
    papers: Mutex<Papers<C>>,
    changed: Condvar,
}

struct Papers<C: Craft> {
    order: Option<C::Order>,
    product: Option<C::Product>,
    is_working: bool,
    is_closed: bool,
}

impl<C: Craft> Desk<C> {
    fn papers(&self) -> MutexGuard<'_, Papers<C>> {
        self.papers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<C: Craft> Studio<C> {
    /// Opens a studio; the craft is learnt on its thread. The window is woken when there is a product.
    pub fn new(ctx: Context, learn: impl FnOnce() -> C + Send + 'static) -> Self {
        let papers = Papers { order: None, product: None, is_working: false, is_closed: false };
        let desk = Arc::new(Desk { papers: Mutex::new(papers), changed: Condvar::new() });
        let worker = Arc::clone(&desk);
        thread::spawn(move || work(&worker, learn(), &ctx));
        Self { desk, last: None }
    }

    /// Orders something, unless it is what was ordered last.
    pub fn order(&mut self, order: C::Order) {
        if self.last.as_ref() != Some(&order) {
            self.last = Some(order.clone());
            self.desk.papers().order = Some(order);
            self.desk.changed.notify_all();
        }
    }

    /// The newest product, once.
    pub fn take(&self) -> Option<C::Product> {
        self.desk.papers().product.take()
    }

    /// Whether something is under way.
    pub fn is_busy(&self) -> bool {
        let papers = self.desk.papers();
        papers.order.is_some() || papers.is_working || papers.product.is_some()
    }
}

impl<C: Craft> Drop for Studio<C> {
    fn drop(&mut self) {
        self.desk.papers().is_closed = true;
        self.desk.changed.notify_all();
    }
}

/// When the window is drawn again: once, for all that comes within this time. At once would be twice, as egui does it.
const SOON: Duration = Duration::from_millis(5);

fn work<C: Craft>(desk: &Desk<C>, mut craft: C, ctx: &Context) {
    // A run that goes on beside the window comes first. Only this thread, and those that it starts, stand back.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(5);
    let mut papers = desk.papers();
    loop {
        if papers.is_closed {
            return;
        }
        if let Some(order) = papers.order.take() {
            papers.is_working = true;
            drop(papers);
            let product = craft.make(order);
            papers = desk.papers();
            papers.is_working = false;
            papers.product = Some(product);
            ctx.request_repaint_after(SOON);
            continue;
        }
        drop(papers);
        let (again, has_news) = craft.idle();
        if has_news {
            ctx.request_repaint_after(SOON);
        }
        papers = desk.papers();
        if papers.order.is_none() && !papers.is_closed {
            papers = match again {
                Some(delay) => {
                    desk.changed.wait_timeout(papers, delay).map_or_else(|broken| broken.into_inner().0, |(p, _)| p)
                }
                None => desk.changed.wait(papers).unwrap_or_else(PoisonError::into_inner),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::time::Instant;

    use super::*;

    /// Tells when it begins and waits to be allowed to go on.
    struct Slow {
        begun: mpsc::Sender<u32>,
        go: mpsc::Receiver<()>,
    }

    impl Craft for Slow {
        type Order = u32;
        type Product = u32;

        fn make(&mut self, order: u32) -> u32 {
            self.begun.send(order).unwrap();
            self.go.recv().unwrap();
            10 * order
        }
    }

    #[test]
    fn orders_that_were_not_begun_are_forgotten() {
        let (begun_sender, begun) = mpsc::channel();
        let (go_sender, go) = mpsc::channel();
        let mut studio = Studio::new(Context::default(), || Slow { begun: begun_sender, go });
        studio.order(1);
        assert_eq!(begun.recv().unwrap(), 1);
        (2..=5).for_each(|order| studio.order(order));
        go_sender.send(()).unwrap();
        assert_eq!(begun.recv().unwrap(), 5);
        assert_eq!(studio.take(), Some(10));
        go_sender.send(()).unwrap();
        let deadline = Instant::now() + Duration::from_secs(60);
        let product = loop {
            match studio.take() {
                None if Instant::now() < deadline => thread::sleep(Duration::from_millis(1)),
                product => break product,
            }
        };
        assert_eq!(product, Some(50));
        // The same again is no order.
        studio.order(5);
        assert!(!studio.is_busy());
    }
}
