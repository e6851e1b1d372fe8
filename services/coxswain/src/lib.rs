//! The person's command: launch a graph of processes, watch it, and end it.
//!
//! | module                | what it holds                                                                      |
//! |-----------------------|------------------------------------------------------------------------------------|
//! | [`options`]           | what a person may say on the command line                                          |
//! | [`graph`]             | the graph file                                                                     |
//! | [`scenario`]          | the scenario file                                                                  |
//! | [`exposure`]          | which addresses of a graph others on the network can reach                         |
//! | [`certificates`]      | `coxswain certificates`: who everybody is on the network                           |
//! | [`assembly`]          | options + graph + scenario + robot → what each process is told. Nothing is started |
//! | [`role`]              | which processes there are, and in which order they start and end                   |
//! | [`folder`]            | the folder of one run                                                              |
//! | [`private`]           | folders of this user that nobody else can enter                                    |
//! | [`registry`]          | where a graph lives on this machine, and what dead launchers left behind           |
//! | [`epochs`]            | the highest epoch of each role, on disk                                            |
//! | [`back_off`]          | when to start again what has died                                                  |
//! | [`child`]             | one process: start, signal, how it ended                                           |
//! | [`watch_command`]     | `coxswain watch`: telemetry → one line per period, or                              |
//! | [`dashboard`]         | the view on a terminal                                                             |
//! | [`watch`]             | `Health` and `Plan` → what the launcher knows                                      |
//! | [`drill`]             | `coxswain drill`: faults in everything, on purpose                                 |
//! | [`faults`]            | the file of faults: what goes wrong on purpose                                     |
//! | [`fault_injector`]    | does it to the processes, and writes down when                                     |
//! | [`processes_by_role`] | who plays which role at this moment                                                |
//! | `silence`             | who says nothing for too long                                                      |
//! | [`fleet`]             | all processes: start in order, restart, end in order                               |
//! | [`launch`]            | one run from reading to sweeping                                                   |
//! | [`service_manager`]   | tells the one that started the launch, if one did, that its loop turns             |
//! | [`progress`]          | the live line                                                                      |
//! | [`closing`]           | `summary.json` → the table at the end                                              |
//! | [`order`]             | `coxswain arm`, `coxswain resume`: an order to the plant of a run                  |
//! | [`set`]               | `coxswain set`: a change to the settings of a robot that drives                    |
//! | [`records`]           | `coxswain report`, `coxswain export`: what is made from records                    |
//! | [`experiment`]        | controllers compared in scenarios                                                  |
//! | [`without_learning`]  | the same run without learning, for the live page to show beside it                 |
//! | [`in_process`]        | the whole graph in one process, in lock step                                       |
//! | [`terminal`]          | everything that is printed                                                         |

pub mod assembly;
pub mod back_off;
pub mod certificates;
pub mod child;
pub mod closing;
pub mod dashboard;
pub mod drill;
pub mod epochs;
pub mod experiment;
pub mod exposure;
pub mod fault_injector;
pub mod faults;
pub mod fleet;
pub mod folder;
pub mod graph;
pub mod in_process;
pub mod launch;
mod memory_filler;
pub mod options;
pub mod order;
pub mod private;
pub mod processes_by_role;
pub mod progress;
pub mod records;
pub mod registry;
pub mod role;
pub mod scenario;
pub mod service_manager;
pub mod set;
mod silence;
pub mod terminal;
pub mod watch;
pub mod watch_command;
pub mod without_learning;
