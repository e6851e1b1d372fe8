//! The command line: launch a graph of processes, watch it, and stop it.
//!
//! | module                | contents                                                             |
//! |-----------------------|----------------------------------------------------------------------|
//! | [`options`]           | options of the command line                                          |
//! | [`graph`]             | the graph file                                                       |
//! | [`hosts`]             | its hosts, and where they meet                                       |
//! | [`all_hosts`]         | a graph with several hosts on this machine                           |
//! | [`scenario`]          | the scenario file                                                    |
//! | [`exposure`]          | addresses of a graph that other machines on the network can reach    |
//! | [`certificates`]      | `coxswain certificates`: identities on the network                   |
//! | [`assembly`]          | options + graph + scenario + robot → settings of each process        |
//! | [`role`]              | the processes, and the order in which they start and stop            |
//! | [`folder`]            | the run directory                                                    |
//! | [`private`]           | directories that only this user can enter                            |
//! | [`registry`]          | graphs on this machine, and the remains of launchers that have ended |
//! | [`epochs`]            | the highest epoch of each role, on disk                              |
//! | [`back_off`]          | when to restart a process that has ended                             |
//! | [`child`]             | one process: start, signal, exit status                              |
//! | [`watch_command`]     | `coxswain watch`: telemetry → lines, or the terminal view            |
//! | [`dashboard`]         | the terminal view                                                    |
//! | [`watch`]             | `Health` and `Plan` → state that the launcher uses                   |
//! | [`drill`]             | `coxswain drill`: fault injection into every part                    |
//! | [`faults`]            | the file of the faults to inject                                     |
//! | [`fault_injector`]    | injects faults into the processes, and records the times             |
//! | [`processes_by_role`] | the present process of each role                                     |
//! | `silence`             | detects missing heartbeats                                           |
//! | [`fleet`]             | all processes: start in order, restart, stop in order                |
//! | [`launch`]            | one run, from reading its files to removing its remains              |
//! | [`service_manager`]   | reports to the service manager that the loop runs                    |
//! | [`progress`]          | the live line                                                        |
//! | [`closing`]           | `summary.json` → the table at the end                                |
//! | [`order`]             | `coxswain arm`, `coxswain resume`: an order to the plant of a run    |
//! | [`set`]               | `coxswain set`: a change of settings while the robot drives          |
//! | [`router`]            | `coxswain router`: a zenoh router at which hosts meet                |
//! | [`records`]           | `coxswain report`, `coxswain export`: reports and tables             |
//! | [`experiment`]        | comparison of controllers in scenarios                               |
//! | [`without_learning`]  | the same run without learning, for comparison on the live page       |
//! | [`in_process`]        | the whole graph in one process, in lock step                         |
//! | [`terminal`]          | all printed output                                                   |

pub mod all_hosts;
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
pub mod hosts;
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
pub mod router;
pub mod scenario;
pub mod service_manager;
pub mod set;
mod silence;
pub mod terminal;
pub mod watch;
pub mod watch_command;
pub mod without_learning;
