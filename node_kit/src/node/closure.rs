//! A node that is a closure: a part of a larger program that needs no parameters.

use super::{context::NodeContext, error::NodeError, process::Process, shell::NodeShell};
use crate::args::RosArguments;

struct Closure<I: Send + 'static>(Handler<I>);

type Handler<I> = Box<dyn FnMut(&mut NodeContext<I>, I)>;

impl<I: Send + 'static> NodeShell for Closure<I> {
    const NAME: &'static str = "closure";
    type Parameters = ();
    type Input = I;

    fn start(_: &mut NodeContext<I>, (): ()) -> Result<Self, NodeError> {
        Err(NodeError::shell("a closure is started by `Process::start_closure`"))
    }

    fn handle(&mut self, context: &mut NodeContext<I>, input: I) {
        (self.0)(context, input);
    }
}

impl Process {
    /// Starts a node of this name without parameters, whose inputs a closure handles.
    ///
    /// `start` subscribes and advertises as [`NodeShell::start`] does, and returns that closure. It
    /// may own what the node shares with the rest of the program, and is called again when the node
    /// is configured again.
    ///
    /// # Errors
    /// As [`Process::start`].
    pub fn start_closure<I: Send + 'static, F: FnMut(&mut NodeContext<I>, I) + 'static>(
        &mut self,
        name: &str,
        mut start: impl FnMut(&mut NodeContext<I>) -> Result<F, NodeError> + Send + 'static,
    ) -> Result<(), NodeError> {
        let mut arguments = RosArguments::default();
        arguments.remap("__node", name);
        self.start_with::<Closure<I>>(&arguments, move |context, ()| {
            Ok(Closure(Box::new(start(context)?)))
        })
    }
}
