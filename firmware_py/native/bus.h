/* A CAN bus in virtual time; buses/inproc.py is the readable reference and explains the rules. */
#ifndef BUS_H
#define BUS_H

#include "frame_bits.h"
#include "lines.h"

#include <structmember.h>

#define MAILBOX_FRAMES 256
#define INBOX_FRAMES 65536

/* Given by Python: its classes, and its function for the length of a frame, which raises. */
static PyObject *frame_type, *counters_type, *statistics_type, *python_frame_bits;

struct bus;

typedef struct {
    PyObject_HEAD
    struct bus *bus;
    PyObject *name;
    PyObject *accepted; /* Set of identifiers; None: all. */
    PyObject *excepted; /* Identifiers for which the opposite of `deaf` holds. */
    PyObject *inbox;    /* List of frames; NULL while empty. */
    PyObject *routes;   /* By identifier, the ports that receive this node's frames. */
    PyObject *counters;
    Py_ssize_t sent, received, dropped_in, dropped_out; /* Not yet added to `counters`. */
    Py_ssize_t waiting, sequence;
    char deaf, open;
} Port;

struct offer {
    unsigned id;
    int bits;
    Py_ssize_t sequence;
    Port *sender;
    PyObject *data;
};

typedef struct bus {
    PyObject_HEAD
    PyObject *name, *record, *log, *carrier, *pacer, *ports;
    struct offer *heap;
    Py_ssize_t count, room;
    long long bit_rate, start_ns, latest_ns, frames, busy_bits;
    long long due_ns; /* Instant at which the pacer acts. */
    bool on_wire, pacing, paused;
    struct offer passing; /* The frame on the wire, which ends at `end_ns`. */
    long long end_ns;
    long long duration_ns[LONGEST_FRAME_BITS + 1];
} Bus;

static PyTypeObject BusType, PortType;

static bool before(const struct offer *one, const struct offer *other)
{
    if (one->id != other->id)
        return one->id < other->id;
    if (one->sender != other->sender)
        return PyUnicode_Compare(one->sender->name, other->sender->name) < 0;
    return one->sequence < other->sequence;
}

static int push(Bus *bus, struct offer offer)
{
    if (bus->count == bus->room) {
        Py_ssize_t room = 2 * bus->room + 64;
        struct offer *heap = PyMem_Realloc(bus->heap, (size_t)room * sizeof *heap);
        if (!heap)
            return PyErr_NoMemory(), -1;
        bus->heap = heap;
        bus->room = room;
    }
    Py_INCREF(offer.sender);
    Py_INCREF(offer.data);
    Py_ssize_t at = bus->count++;
    for (; at > 0 && before(&offer, &bus->heap[(at - 1) / 2]); at = (at - 1) / 2)
        bus->heap[at] = bus->heap[(at - 1) / 2];
    bus->heap[at] = offer;
    return 0;
}

static void sink(Bus *bus, Py_ssize_t at)
{
    struct offer offer = bus->heap[at];
    for (;;) {
        Py_ssize_t child = 2 * at + 1;
        if (child >= bus->count)
            break;
        if (child + 1 < bus->count && before(&bus->heap[child + 1], &bus->heap[child]))
            child++;
        if (!before(&bus->heap[child], &offer))
            break;
        bus->heap[at] = bus->heap[child];
        at = child;
    }
    bus->heap[at] = offer;
}

/* Take the first offer; its references go to the caller. */
static struct offer pop(Bus *bus)
{
    struct offer first = bus->heap[0];
    bus->heap[0] = bus->heap[--bus->count];
    if (bus->count)
        sink(bus, 0);
    return first;
}

static void drop(struct offer *offer)
{
    Py_CLEAR(offer->sender);
    Py_CLEAR(offer->data);
}

static int accepts(const Port *port, PyObject *id)
{
    int excepted = PySet_Contains(port->excepted, id);
    if (excepted < 0 || port->deaf != excepted)
        return excepted < 0 ? -1 : 0;
    return port->accepted == Py_None ? 1 : PySet_Contains(port->accepted, id);
}

/* The ports that receive a node's frames of one identifier; a borrowed tuple. */
static PyObject *route(Port *sender, PyObject *id)
{
    PyObject *found = PyDict_GetItemWithError(sender->routes, id);
    if (found || PyErr_Occurred())
        return found;
    PyObject *list = PyList_New(0), *port, *name;
    Py_ssize_t at = 0;
    while (list && PyDict_Next(sender->bus->ports, &at, &name, &port)) {
        int hears = port == (PyObject *)sender ? 0 : accepts((Port *)port, id);
        if (hears < 0 || (hears && PyList_Append(list, port) < 0))
            Py_CLEAR(list);
    }
    PyObject *ports = list ? PyList_AsTuple(list) : NULL;
    Py_XDECREF(list);
    if (ports && PyDict_SetItem(sender->routes, id, ports) < 0)
        Py_CLEAR(ports);
    Py_XDECREF(ports); /* The dictionary holds it. */
    return ports;
}

static int deliver(Port *sender, PyObject *frame, PyObject *id)
{
    PyObject *ports = route(sender, id);
    if (!ports)
        return -1;
    for (Py_ssize_t at = 0; at < PyTuple_GET_SIZE(ports); at++) {
        Port *port = (Port *)PyTuple_GET_ITEM(ports, at);
        if (!port->inbox && !(port->inbox = PyList_New(0)))
            return -1;
        if (PyList_GET_SIZE(port->inbox) >= INBOX_FRAMES)
            port->dropped_in++;
        else if (PyList_Append(port->inbox, frame) < 0)
            return -1;
    }
    return 0;
}

/* Deliver a completed frame. */
static int end_frame(Bus *bus, PyObject *frame, Port *sender, int bits)
{
    PyObject *id = PyTuple_GET_ITEM(frame, 1), *data = PyTuple_GET_ITEM(frame, 2);
    bus->frames++;
    bus->busy_bits += bits;
    if (bus->log != Py_None &&
        candump_frame((CandumpLines *)bus->log, PyLong_AsLongLong(PyTuple_GET_ITEM(frame, 0)),
                      (unsigned)PyLong_AsUnsignedLong(id), (uint8_t *)PyBytes_AS_STRING(data),
                      (size_t)PyBytes_GET_SIZE(data)) < 0)
        return -1;
    if (bus->record != Py_None) {
        PyObject *args[] = {frame, sender->name};
        PyObject *done = PyObject_Vectorcall(bus->record, args, 2, NULL);
        if (!done)
            return -1;
        Py_DECREF(done);
    }
    if (deliver(sender, frame, id) < 0)
        return -1;
    if (bus->pacer == Py_None)
        return 0;
    PyObject *done = PyObject_CallMethod(bus->pacer, "ended", "OO", frame, sender->name);
    Py_XDECREF(done);
    return done ? 0 : -1;
}

static PyObject *frame_of(long long end_ns, unsigned id, PyObject *data)
{
    PyTypeObject *type = (PyTypeObject *)frame_type;
    PyObject *stamp = PyLong_FromLongLong(end_ns), *number = PyLong_FromUnsignedLong(id);
    PyObject *frame = stamp && number ? type->tp_alloc(type, 6) : NULL;
    if (!frame) {
        Py_XDECREF(stamp);
        Py_XDECREF(number);
        return NULL;
    }
    PyTuple_SET_ITEM(frame, 0, stamp);
    PyTuple_SET_ITEM(frame, 1, number);
    PyTuple_SET_ITEM(frame, 2, Py_NewRef(data));
    for (Py_ssize_t at = 3; at < 6; at++)
        PyTuple_SET_ITEM(frame, at, Py_NewRef(Py_False));
    return frame;
}

static int end_offer(Bus *bus, struct offer offer, long long end_ns)
{
    PyObject *frame = frame_of(end_ns, offer.id, offer.data);
    int failed = frame ? end_frame(bus, frame, offer.sender, offer.bits) : -1;
    Py_XDECREF(frame);
    drop(&offer);
    return failed;
}

static int set_latest(Bus *bus, long long now_ns)
{
    if (now_ns < bus->latest_ns) {
        PyErr_SetString(PyExc_AssertionError, "time ran backwards");
        return -1;
    }
    bus->latest_ns = now_ns;
    return 0;
}

static int carry_on(Bus *bus, long long now_ns);

static int advance(Bus *bus, long long now_ns)
{
    if (bus->pacer == Py_None || bus->pacing)
        return carry_on(bus, now_ns);
    bool acts = now_ns >= bus->due_ns;
    int failed = 0;
    bus->pacing = true;
    if (!acts)
        failed = carry_on(bus, now_ns);
    if (!failed && (acts || bus->paused)) {
        PyObject *pacer = Py_NewRef(bus->pacer);
        PyObject *done = PyObject_CallMethod(pacer, "advance", "L", now_ns);
        failed = done ? 0 : -1;
        Py_XDECREF(done);
        Py_DECREF(pacer);
    }
    bus->pacing = false;
    return failed;
}

static int carry_on(Bus *bus, long long now_ns)
{
    bus->paused = false;
    if (set_latest(bus, now_ns) < 0)
        return -1;
    if (bus->carrier != Py_None) {
        PyObject *done = PyObject_CallMethod(bus->carrier, "advance", "L", now_ns);
        Py_XDECREF(done);
        return done ? 0 : -1;
    }
    if (bus->on_wire) {
        if (bus->end_ns > now_ns)
            return 0;
        bus->on_wire = false;
        if (end_offer(bus, bus->passing, bus->end_ns) < 0)
            return -1;
    }
    while (bus->count && bus->start_ns < now_ns && !bus->paused) {
        struct offer offer = pop(bus);
        long long end_ns = bus->start_ns + bus->duration_ns[offer.bits - INTERMISSION_BITS];
        bus->start_ns += bus->duration_ns[offer.bits];
        offer.sender->waiting--;
        if (end_ns > now_ns) {
            bus->on_wire = true;
            bus->passing = offer;
            bus->end_ns = end_ns;
            return 0;
        }
        if (end_offer(bus, offer, end_ns) < 0)
            return -1;
    }
    return 0;
}

static int carry(Bus *bus, long long now_ns, struct offer offer)
{
    if (advance(bus, now_ns) < 0)
        return -1;
    PyObject *accepted = PyObject_CallMethod(
        bus->carrier, "offer", "L(IOiiOO)", now_ns, offer.id, offer.sender->name, 0, offer.bits,
        offer.data, (PyObject *)offer.sender);
    if (!accepted)
        return -1;
    if (!PyObject_IsTrue(accepted))
        offer.sender->dropped_out++;
    Py_DECREF(accepted);
    return 0;
}

static int offer_frame(Bus *bus, long long now_ns, struct offer offer)
{
    Port *sender = offer.sender;
    if (bus->pacer != Py_None && !bus->pacing && advance(bus, now_ns) < 0)
        return -1;
    if (bus->carrier != Py_None)
        return carry(bus, now_ns, offer);
    /* Frames that start before this offer do not arbitrate against it. */
    if (bus->count && bus->start_ns < now_ns && advance(bus, now_ns) < 0)
        return -1;
    if (set_latest(bus, now_ns) < 0)
        return -1;
    if (bus->start_ns < now_ns)
        bus->start_ns = now_ns; /* The bus is idle. */
    if (sender->waiting >= MAILBOX_FRAMES) {
        sender->dropped_out++;
        return 0;
    }
    sender->waiting++;
    sender->sent++;
    offer.sequence = ++sender->sequence;
    return push(bus, offer);
}

static void forget_all_routes(Bus *bus)
{
    PyObject *name, *port;
    Py_ssize_t at = 0;
    while (PyDict_Next(bus->ports, &at, &name, &port))
        PyDict_Clear(((Port *)port)->routes);
}

static int disconnect(Bus *bus, Port *leaving)
{
    Py_ssize_t kept = 0;
    if (PyDict_DelItem(bus->ports, leaving->name) < 0)
        return -1;
    if (bus->carrier != Py_None) {
        PyObject *gone = PyObject_CallMethod(bus->carrier, "forget", "O", (PyObject *)leaving);
        if (!gone)
            return -1;
        leaving->dropped_out += PyLong_AsSsize_t(gone);
        Py_DECREF(gone);
    }
    for (Py_ssize_t at = 0; at < bus->count; at++) {
        if (bus->heap[at].sender != leaving) {
            bus->heap[kept++] = bus->heap[at];
            continue;
        }
        leaving->dropped_out++;
        Py_DECREF(bus->heap[at].sender); /* The caller holds the port. */
        Py_DECREF(bus->heap[at].data);
    }
    bus->count = kept;
    for (Py_ssize_t at = kept / 2 - 1; at >= 0; at--)
        sink(bus, at);
    PyDict_Clear(leaving->routes);
    forget_all_routes(bus);
    return 0;
}

/* The port as Python sees it. */

static PyObject *port_send(Port *self, PyObject *const *args, Py_ssize_t given)
{
    if (given != 3)
        return PyErr_Format(PyExc_TypeError, "send takes instant, identifier and data");
    if (!self->open) {
        self->dropped_out++;
        Py_RETURN_NONE;
    }
    long long now_ns = PyLong_AsLongLong(args[0]);
    long id = PyLong_AsLong(args[1]);
    if (PyErr_Occurred())
        return NULL;
    PyObject *data = PyBytes_FromObject(args[2]);
    if (!data)
        return NULL;
    Py_ssize_t size = PyBytes_GET_SIZE(data);
    int failed = -1;
    if (id < 0 || id >= 2048 || size > 8) {
        /* Python's function raises the error for what no classic frame can carry. */
        PyObject *bits = PyObject_CallFunction(python_frame_bits, "lO", id, data);
        Py_XDECREF(bits);
        if (bits)
            PyErr_SetString(PyExc_ValueError, "no classic frame");
    } else {
        const uint8_t *raw = (const uint8_t *)PyBytes_AS_STRING(data);
        int bits = frame_bits((unsigned)id, raw, (unsigned)size);
        failed = offer_frame(self->bus, now_ns, (struct offer){(unsigned)id, bits, 0, self, data});
    }
    Py_DECREF(data);
    return failed ? NULL : Py_NewRef(Py_None);
}

static PyObject *port_receive(Port *self, PyObject *now)
{
    if (self->open) {
        long long now_ns = PyLong_AsLongLong(now);
        if ((now_ns == -1 && PyErr_Occurred()) || advance(self->bus, now_ns) < 0)
            return NULL;
    }
    PyObject *inbox = self->inbox;
    if (!inbox)
        return PyTuple_New(0);
    self->inbox = NULL;
    self->received += PyList_GET_SIZE(inbox);
    return inbox;
}

static PyObject *port_accepts(Port *self, PyObject *id)
{
    int found = accepts(self, id);
    return found < 0 ? NULL : PyBool_FromLong(found);
}

static PyObject *port_close(Port *self, PyObject *unused)
{
    if (self->open) {
        self->open = 0;
        if (disconnect(self->bus, self) < 0)
            return NULL;
    }
    Py_RETURN_NONE;
}

static int add_count(PyObject *counters, const char *name, Py_ssize_t *more)
{
    if (!*more)
        return 0;
    PyObject *old = PyObject_GetAttrString(counters, name);
    PyObject *new = old ? PyLong_FromSsize_t(PyLong_AsSsize_t(old) + *more) : NULL;
    int failed = new ? PyObject_SetAttrString(counters, name, new) : -1;
    *more = 0;
    Py_XDECREF(old);
    Py_XDECREF(new);
    return failed;
}

/* The counters as an object, up to date. */
static PyObject *port_counters(Port *self, void *unused)
{
    PyObject *counters = self->counters;
    if (add_count(counters, "sent", &self->sent) < 0 ||
        add_count(counters, "received", &self->received) < 0 ||
        add_count(counters, "dropped_in", &self->dropped_in) < 0 ||
        add_count(counters, "dropped_out", &self->dropped_out) < 0)
        return NULL;
    return Py_NewRef(counters);
}

static int port_set_excepted(Port *self, PyObject *value, void *unused)
{
    if (!value || !PyAnySet_Check(value)) {
        PyErr_SetString(PyExc_TypeError, "a set of identifiers");
        return -1;
    }
    Py_XSETREF(self->excepted, Py_NewRef(value));
    return 0;
}

static PyObject *port_excepted(Port *self, void *unused)
{
    return Py_NewRef(self->excepted);
}

static int port_traverse(PyObject *object, visitproc visit, void *arg)
{
    Port *self = (Port *)object;
    Py_VISIT(self->bus);
    Py_VISIT(self->routes);
    Py_VISIT(self->inbox);
    Py_VISIT(self->counters);
    return 0;
}

static int port_clear(PyObject *object)
{
    Port *self = (Port *)object;
    Py_CLEAR(self->bus);
    Py_CLEAR(self->routes);
    Py_CLEAR(self->inbox);
    return 0;
}

static void port_dealloc(PyObject *object)
{
    Port *self = (Port *)object;
    PyObject_GC_UnTrack(object);
    port_clear(object);
    Py_CLEAR(self->name);
    Py_CLEAR(self->accepted);
    Py_CLEAR(self->excepted);
    Py_CLEAR(self->counters);
    Py_TYPE(object)->tp_free(object);
}

static PyMethodDef port_methods[] = {
    {"send", (PyCFunction)(void (*)(void))port_send, METH_FASTCALL, NULL},
    {"receive", (PyCFunction)port_receive, METH_O, NULL},
    {"accepts", (PyCFunction)port_accepts, METH_O, NULL},
    {"close", (PyCFunction)port_close, METH_NOARGS, NULL},
    {NULL},
};

static PyMemberDef port_members[] = {
    {"name", T_OBJECT_EX, offsetof(Port, name), READONLY},
    {"is_open", T_BOOL, offsetof(Port, open), READONLY},
    {"_accepted", T_OBJECT, offsetof(Port, accepted), READONLY},
    {"_deaf", T_BOOL, offsetof(Port, deaf)},
    {"_waiting", T_PYSSIZET, offsetof(Port, waiting)},
    {"_sequence", T_PYSSIZET, offsetof(Port, sequence)},
    {NULL},
};

static PyGetSetDef port_properties[] = {
    {"counters", (getter)port_counters, NULL, NULL, NULL},
    {"_excepted", (getter)port_excepted, (setter)port_set_excepted, NULL, NULL},
    {NULL},
};

static PyTypeObject PortType = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "bench_core.Port",
    .tp_basicsize = sizeof(Port),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_traverse = port_traverse,
    .tp_clear = port_clear,
    .tp_dealloc = port_dealloc,
    .tp_methods = port_methods,
    .tp_members = port_members,
    .tp_getset = port_properties,
};

/* The bus as Python sees it. */

static PyObject *bus_new(PyTypeObject *type, PyObject *args, PyObject *named)
{
    static char *names[] = {"name", "bit_rate", "record", "log", NULL};
    PyObject *name, *record = Py_None, *log = Py_None;
    long long bit_rate;
    if (!PyArg_ParseTupleAndKeywords(args, named, "UL|OO", names, &name, &bit_rate, &record, &log))
        return NULL;
    if (bit_rate <= 0)
        return PyErr_Format(PyExc_ValueError, "bus %R: bit rate %lld is not positive", name,
                            bit_rate);
    if (log != Py_None && !Py_IS_TYPE(log, &CandumpLinesType))
        return PyErr_Format(PyExc_TypeError, "bus %R: the log is not of this module", name);
    Bus *self = (Bus *)type->tp_alloc(type, 0);
    if (!self)
        return NULL;
    self->name = Py_NewRef(name);
    self->record = Py_NewRef(record);
    self->log = Py_NewRef(log);
    self->carrier = Py_NewRef(Py_None);
    self->pacer = Py_NewRef(Py_None);
    self->bit_rate = bit_rate;
    for (int bits = 0; bits <= LONGEST_FRAME_BITS; bits++)
        self->duration_ns[bits] = NS_PER_S * bits / bit_rate;
    if (!(self->ports = PyDict_New()))
        Py_CLEAR(self);
    return (PyObject *)self;
}

static PyObject *bus_port(Bus *self, PyObject *args, PyObject *named)
{
    static char *names[] = {"node_name", "accept_ids", NULL};
    PyObject *name, *accept = Py_None;
    if (!PyArg_ParseTupleAndKeywords(args, named, "U|O", names, &name, &accept))
        return NULL;
    int known = PyDict_Contains(self->ports, name);
    if (known > 0)
        PyErr_Format(PyExc_ValueError, "bus %R: a node %R is connected already", self->name, name);
    if (known)
        return NULL;
    Port *port = (Port *)PortType.tp_alloc(&PortType, 0);
    if (!port)
        return NULL;
    port->bus = (Bus *)Py_NewRef(self);
    port->name = Py_NewRef(name);
    port->open = 1;
    port->accepted = accept == Py_None ? Py_NewRef(accept) : PyFrozenSet_New(accept);
    port->excepted = PyFrozenSet_New(NULL);
    port->routes = PyDict_New();
    port->counters = PyObject_CallNoArgs(counters_type);
    if (!port->accepted || !port->excepted || !port->routes || !port->counters ||
        PyDict_SetItem(self->ports, name, (PyObject *)port) < 0) {
        Py_DECREF(port);
        return NULL;
    }
    forget_all_routes(self);
    return (PyObject *)port;
}

static PyObject *bus_statistics(Bus *self, PyObject *unused)
{
    long long waiting = self->on_wire;
    PyObject *name, *port;
    Py_ssize_t at = 0;
    if (self->carrier != Py_None) {
        PyObject *on_wire = PyObject_GetAttrString(self->carrier, "on_wire");
        if (!on_wire)
            return NULL;
        waiting = PyLong_AsLong(on_wire);
        Py_DECREF(on_wire);
    }
    while (PyDict_Next(self->ports, &at, &name, &port))
        waiting += ((Port *)port)->waiting;
    /* The product may exceed 64 bits after some years of traffic. */
    long long busy_ns = (long long)((__int128)NS_PER_S * self->busy_bits / self->bit_rate);
    return PyObject_CallFunction(statistics_type, "LLL", self->frames, busy_ns, waiting);
}

static PyObject *bus_advance(Bus *self, PyObject *now)
{
    long long now_ns = PyLong_AsLongLong(now);
    if ((now_ns == -1 && PyErr_Occurred()) || advance(self, now_ns) < 0)
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *bus_pace(Bus *self, PyObject *pacer)
{
    Py_XSETREF(self->pacer, Py_NewRef(pacer));
    Py_RETURN_NONE;
}

static PyObject *bus_pause(Bus *self, PyObject *at)
{
    self->latest_ns = PyLong_AsLongLong(at);
    self->paused = true;
    return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
}

static PyObject *bus_end(Bus *self, PyObject *args)
{
    PyObject *frame;
    Port *sender;
    int bits;
    if (!PyArg_ParseTuple(args, "O!O!i", &PyTuple_Type, &frame, &PortType, &sender, &bits))
        return NULL;
    if (PyTuple_GET_SIZE(frame) < 3 || !PyBytes_Check(PyTuple_GET_ITEM(frame, 2)))
        return PyErr_Format(PyExc_TypeError, "not a frame: %R", frame);
    return end_frame(self, frame, sender, bits) < 0 ? NULL : Py_NewRef(Py_None);
}

static PyObject *bus_forget_routes(Bus *self, PyObject *unused)
{
    forget_all_routes(self);
    Py_RETURN_NONE;
}

static PyObject *offer_tuple(const struct offer *offer)
{
    return Py_BuildValue("IOniOO", offer->id, offer->sender->name, offer->sequence, offer->bits,
                         offer->data, (PyObject *)offer->sender);
}

static PyObject *bus_hand_over(Bus *self, PyObject *carrier)
{
    if (self->carrier != Py_None) {
        PyErr_SetString(PyExc_AssertionError, "another one carries this bus");
        return NULL;
    }
    PyObject *offers = PyList_New(0), *on_wire = Py_NewRef(Py_None), *found = NULL;
    while (offers && self->count) {
        struct offer offer = pop(self);
        PyObject *tuple = offer_tuple(&offer);
        offer.sender->waiting--;
        drop(&offer);
        if (!tuple || PyList_Append(offers, tuple) < 0)
            Py_CLEAR(offers);
        Py_XDECREF(tuple);
    }
    if (offers && self->on_wire) {
        Py_DECREF(on_wire);
        on_wire = Py_BuildValue("LN", self->end_ns, offer_tuple(&self->passing));
        self->on_wire = false;
        drop(&self->passing);
    }
    if (offers && on_wire) {
        Py_XSETREF(self->carrier, Py_NewRef(carrier));
        found = Py_BuildValue("LOO", self->start_ns, offers, on_wire);
    }
    Py_XDECREF(offers);
    Py_XDECREF(on_wire);
    return found;
}

static int bus_traverse(PyObject *object, visitproc visit, void *arg)
{
    Bus *self = (Bus *)object;
    Py_VISIT(self->record);
    Py_VISIT(self->log);
    Py_VISIT(self->carrier);
    Py_VISIT(self->pacer);
    Py_VISIT(self->ports);
    for (Py_ssize_t at = 0; at < self->count; at++)
        Py_VISIT(self->heap[at].sender);
    if (self->on_wire)
        Py_VISIT(self->passing.sender);
    return 0;
}

static int bus_clear(PyObject *object)
{
    Bus *self = (Bus *)object;
    while (self->count)
        drop(&self->heap[--self->count]);
    if (self->on_wire) {
        self->on_wire = false;
        drop(&self->passing);
    }
    Py_CLEAR(self->record);
    Py_CLEAR(self->log);
    Py_CLEAR(self->carrier);
    Py_CLEAR(self->pacer);
    Py_CLEAR(self->ports);
    return 0;
}

static void bus_dealloc(PyObject *object)
{
    Bus *self = (Bus *)object;
    PyObject_GC_UnTrack(object);
    bus_clear(object);
    Py_CLEAR(self->name);
    PyMem_Free(self->heap);
    Py_TYPE(object)->tp_free(object);
}

static PyMethodDef bus_methods[] = {
    {"port", (PyCFunction)(void (*)(void))bus_port, METH_VARARGS | METH_KEYWORDS, NULL},
    {"statistics", (PyCFunction)bus_statistics, METH_NOARGS, NULL},
    {"advance", (PyCFunction)bus_advance, METH_O, NULL},
    {"hand_over", (PyCFunction)bus_hand_over, METH_O, NULL},
    {"pace", (PyCFunction)bus_pace, METH_O, NULL},
    {"pause", (PyCFunction)bus_pause, METH_O, NULL},
    {"_end", (PyCFunction)bus_end, METH_VARARGS, NULL},
    {"_forget_routes", (PyCFunction)bus_forget_routes, METH_NOARGS, NULL},
    {NULL},
};

static PyMemberDef bus_members[] = {
    {"name", T_OBJECT_EX, offsetof(Bus, name), READONLY},
    {"bit_rate", T_LONGLONG, offsetof(Bus, bit_rate), READONLY},
    {"due_ns", T_LONGLONG, offsetof(Bus, due_ns)},
    {"_ports", T_OBJECT_EX, offsetof(Bus, ports), READONLY},
    {"_bits", T_LONGLONG, offsetof(Bus, busy_bits)},
    {NULL},
};

static PyTypeObject BusType = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "bench_core.Bus",
    .tp_basicsize = sizeof(Bus),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = bus_new,
    .tp_traverse = bus_traverse,
    .tp_clear = bus_clear,
    .tp_dealloc = bus_dealloc,
    .tp_methods = bus_methods,
    .tp_members = bus_members,
};

#endif
