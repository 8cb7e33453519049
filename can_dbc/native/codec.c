/* Python's way to the messages of wire.h: senders and receivers that read and make frame objects.
 *
 * Only what is usual is decided here. For a value of another type than the field's, for a number
 * that is none, and for the text of a rejection, the functions of Python's codec are called.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <structmember.h>

/* One translation unit, and hidden names, so that the compiler may inline the wire. */
#pragma GCC visibility push(hidden)
#include "wire.c"
#pragma GCC visibility pop

#define FIELDS_MAX 64
#define STRUCTURE_MAX (8 * FIELDS_MAX)

/* How one field of a frame class is read and written. */
struct access {
    PyObject *name;
    Py_ssize_t slot;    /* Place of the slot in the object; 0: through the attribute. */
    PyObject *members;  /* Tuple with the member of every raw value; only for enumerations. */
    PyObject *type;     /* Class of the enumeration. */
};

struct layout {
    const struct wire_message *message;
    PyTypeObject *kind;
    bool by_slots; /* All fields are slots, so that an object is made without its constructor. */
    struct access fields[FIELDS_MAX];
};

static PyObject *value_name;

static const struct wire_message *message_of(unsigned int id)
{
    for (size_t at = 0; at < WIRE_MESSAGES; at++)
        if (wire_messages[at].id == id)
            return &wire_messages[at];
    return NULL;
}

static void layout_clear(struct layout *layout)
{
    Py_CLEAR(layout->kind);
    for (size_t at = 0; layout->message && at < layout->message->count; at++) {
        Py_CLEAR(layout->fields[at].name);
        Py_CLEAR(layout->fields[at].members);
        Py_CLEAR(layout->fields[at].type);
    }
}

static int layout_visit(struct layout *layout, visitproc visit, void *arg)
{
    Py_VISIT(layout->kind);
    for (size_t at = 0; layout->message && at < layout->message->count; at++) {
        Py_VISIT(layout->fields[at].members);
        Py_VISIT(layout->fields[at].type);
    }
    return 0;
}

/* `tables` has for each field (class, members) of an enumeration, or None. */
static int layout_init(struct layout *layout, unsigned int id, PyObject *kind, PyObject *tables)
{
    const struct wire_message *message = message_of(id);
    if (!message || message->count > FIELDS_MAX || message->size > STRUCTURE_MAX) {
        PyErr_Format(PyExc_LookupError, "no compiled message %u", id);
        return -1;
    }
    if (!PyTuple_Check(tables) || (size_t)PyTuple_GET_SIZE(tables) != message->count) {
        PyErr_Format(PyExc_LookupError, "%s has other fields", message->name);
        return -1;
    }
    layout->message = message;
    layout->kind = (PyTypeObject *)Py_NewRef(kind);
    layout->by_slots = true;
    for (size_t at = 0; at < message->count; at++) {
        struct access *access = &layout->fields[at];
        access->name = PyUnicode_InternFromString(message->fields[at].name);
        PyObject *found = access->name ? PyObject_GetAttr(kind, access->name) : NULL;
        if (!found)
            return -1;
        if (Py_IS_TYPE(found, &PyMemberDescr_Type)) {
            PyMemberDef *member = ((PyMemberDescrObject *)found)->d_member;
            if (member->type == T_OBJECT_EX)
                access->slot = member->offset;
        }
        Py_DECREF(found);
        layout->by_slots = layout->by_slots && access->slot > 0;
        PyObject *table = PyTuple_GET_ITEM(tables, at);
        if (table != Py_None) {
            access->type = Py_NewRef(PyTuple_GetItem(table, 0));
            access->members = Py_NewRef(PyTuple_GetItem(table, 1));
        }
    }
    return 0;
}

/* Put a usual value into its place. 0: done; 1: not usual, Python decides; -1: error. */
static int put_value(const struct access *access, enum wire_kind kind, PyObject *value, void *to)
{
    switch (kind) {
    case WIRE_FLOAT: {
        double number;
        if (PyFloat_CheckExact(value)) {
            number = PyFloat_AS_DOUBLE(value);
        } else {
            if (!PyLong_CheckExact(value))
                return 1;
            int beyond;
            long long whole = PyLong_AsLongLongAndOverflow(value, &beyond);
            if (beyond || whole > (1LL << 53) || whole < -(1LL << 53))
                return 1;
            number = (double)whole;
        }
        *(double *)to = number;
        return number != number;
    }
    case WIRE_INT: {
        if (!PyLong_CheckExact(value))
            return 1;
        int beyond;
        *(int64_t *)to = PyLong_AsLongLongAndOverflow(value, &beyond);
        return beyond != 0;
    }
    case WIRE_BOOL:
        *(bool *)to = value == Py_True;
        return value != Py_True && value != Py_False;
    case WIRE_ENUM: {
        if ((PyObject *)Py_TYPE(value) != access->type)
            return 1;
        PyObject *number = PyObject_GetAttr(value, value_name);
        if (!number)
            return -1;
        long raw = PyLong_AsLong(number);
        Py_DECREF(number);
        if (raw == -1 && PyErr_Occurred())
            return -1;
        *(uint16_t *)to = (uint16_t)raw;
        return 0;
    }
    }
    return 1;
}

/* Payload of a frame object. 0: done; 1: Python decides; -1: error. */
static int payload_of(const struct layout *layout, PyObject *frame, uint64_t *bits)
{
    uint64_t room[STRUCTURE_MAX / 8];
    const struct wire_message *message = layout->message;
    if (Py_TYPE(frame) != layout->kind)
        return 1;
    for (size_t at = 0; at < message->count; at++) {
        const struct access *access = &layout->fields[at];
        PyObject *value;
        if (access->slot)
            value = Py_XNewRef(*(PyObject **)((char *)frame + access->slot));
        else
            value = PyObject_GetAttr(frame, access->name);
        if (!value)
            return PyErr_Occurred() ? -1 : 1;
        char *to = (char *)room + message->fields[at].offset;
        int unusual = put_value(access, message->fields[at].kind, value, to);
        Py_DECREF(value);
        if (unusual)
            return unusual;
    }
    return message->pack(room, bits) ? 0 : 1;
}

static PyObject *value_from(const struct access *access, enum wire_kind kind, const void *from)
{
    switch (kind) {
    case WIRE_FLOAT:
        return PyFloat_FromDouble(*(const double *)from);
    case WIRE_INT:
        return PyLong_FromLongLong(*(const int64_t *)from);
    case WIRE_BOOL:
        return PyBool_FromLong(*(const bool *)from);
    case WIRE_ENUM:
        return Py_XNewRef(PyTuple_GetItem(access->members, *(const uint16_t *)from));
    }
    return NULL;
}

/* Frame object of a payload; None if a value is outside its range or table. */
static PyObject *frame_from(const struct layout *layout, uint64_t bits)
{
    uint64_t room[STRUCTURE_MAX / 8];
    const struct wire_message *message = layout->message;
    PyObject *values[FIELDS_MAX], *frame = NULL;
    size_t count = 0;
    if (!message->unpack(bits, room))
        Py_RETURN_NONE;
    for (; count < message->count; count++) {
        const char *from = (const char *)room + message->fields[count].offset;
        values[count] = value_from(&layout->fields[count], message->fields[count].kind, from);
        if (!values[count])
            goto done;
    }
    if (!layout->by_slots) {
        frame = PyObject_Vectorcall((PyObject *)layout->kind, values, count, NULL);
    } else if ((frame = layout->kind->tp_alloc(layout->kind, 0))) {
        for (size_t at = 0; at < count; at++)
            *(PyObject **)((char *)frame + layout->fields[at].slot) = Py_NewRef(values[at]);
    }
done:
    while (count)
        Py_DECREF(values[--count]);
    return frame;
}

/* Frame classes whose objects C makes, whoever asks for one. The constructor of a frozen dataclass
 * is Python, and sets each field through `object.__setattr__`. Power of two, never half full. */
#define MAKERS 256
static struct layout *makers[MAKERS];

static struct layout **maker_of(const PyObject *kind)
{
    size_t at = ((uintptr_t)kind >> 4) % MAKERS;
    while (makers[at] && makers[at]->kind != (const PyTypeObject *)kind)
        at = (at + 1) % MAKERS;
    return &makers[at];
}

/* The place of a keyword among the fields; their number if it names none. */
static size_t field_named(const struct layout *layout, PyObject *name)
{
    size_t at = 0;
    while (at < layout->message->count && layout->fields[at].name != name)
        at++;
    return at;
}

static PyObject *usual_call(PyObject *kind, PyObject *const *args, size_t given, PyObject *names)
{
    size_t count = (size_t)PyVectorcall_NARGS(given);
    PyObject *words = names ? PyDict_New() : NULL, *made = NULL;
    PyObject *values = PyTuple_New((Py_ssize_t)count);
    if (values && (words || !names)) {
        for (size_t at = 0; at < count; at++)
            PyTuple_SET_ITEM(values, (Py_ssize_t)at, Py_NewRef(args[at]));
        Py_ssize_t at = 0, named = names ? PyTuple_GET_SIZE(names) : 0;
        while (at < named &&
               PyDict_SetItem(words, PyTuple_GET_ITEM(names, at), args[count + (size_t)at]) == 0)
            at++;
        if (at == named)
            made = PyType_Type.tp_call(kind, values, words);
    }
    Py_XDECREF(values);
    Py_XDECREF(words);
    return made;
}

/* A frame object with just these values. Defaults and mistakes are left to the constructor. */
static PyObject *make_frame(PyObject *kind, PyObject *const *args, size_t given, PyObject *names)
{
    const struct layout *layout = *maker_of(kind);
    size_t count = (size_t)PyVectorcall_NARGS(given);
    size_t named = names ? (size_t)PyTuple_GET_SIZE(names) : 0;
    if (!layout || count + named != layout->message->count)
        return usual_call(kind, args, given, names);
    PyObject *frame = layout->kind->tp_alloc(layout->kind, 0);
    if (!frame)
        return NULL;
    for (size_t at = 0; at < count + named; at++) {
        size_t field = at < count ? at
                                  : field_named(layout, PyTuple_GET_ITEM(names, (Py_ssize_t)(at - count)));
        PyObject **slot = field < layout->message->count
                              ? (PyObject **)((char *)frame + layout->fields[field].slot)
                              : NULL;
        if (!slot || *slot) {
            Py_DECREF(frame);
            return usual_call(kind, args, given, names);
        }
        *slot = Py_NewRef(args[at]);
    }
    return frame;
}

/* Let `make_frame` make the objects of a class from now on; it stays so for the life of the process. */
static int make_natively(const struct layout *layout)
{
    static int made;
    PyTypeObject *kind = layout->kind;
    struct layout **place = maker_of((PyObject *)kind);
    if (*place || !layout->by_slots || kind->tp_vectorcall || made >= MAKERS / 2 ||
        PyObject_HasAttrString((PyObject *)kind, "__post_init__"))
        return 0;
    struct layout *copy = PyMem_Malloc(sizeof *copy);
    if (!copy) {
        PyErr_NoMemory();
        return -1;
    }
    *copy = *layout;
    Py_INCREF(kind);
    for (size_t at = 0; at < copy->message->count; at++) {
        Py_INCREF(copy->fields[at].name);
        copy->fields[at].members = copy->fields[at].type = NULL;
    }
    *place = copy;
    made++;
    kind->tp_vectorcall = make_frame;
    return 0;
}

/* A callable that gives the identifiers and data of a frame object. */
typedef struct {
    PyObject_HEAD
    vectorcallfunc call;
    struct layout layout;
    PyObject *pack;  /* Python's function from frame to payload, for what is not usual. */
    PyObject *last;  /* The frame whose payload is kept. */
    PyObject *id, *twin_id;
    uint64_t payload;
    uint8_t counter;
} Sender;

static int python_payload(Sender *self, PyObject *frame, uint64_t *payload)
{
    PyObject *bits = PyObject_CallOneArg(self->pack, frame);
    if (!bits)
        return -1;
    *payload = PyLong_AsUnsignedLongLong(bits);
    Py_DECREF(bits);
    return PyErr_Occurred() ? -1 : 0;
}

static PyObject *half_of(PyObject *id, const uint8_t *data, size_t length)
{
    PyObject *bytes = PyBytes_FromStringAndSize((const char *)data, (Py_ssize_t)length);
    PyObject *half = bytes ? PyTuple_Pack(2, id, bytes) : NULL;
    Py_XDECREF(bytes);
    return half;
}

static PyObject *sender_call(PyObject *callable, PyObject *const *args, size_t given, PyObject *names)
{
    Sender *self = (Sender *)callable;
    const struct wire_message *message = self->layout.message;
    if (PyVectorcall_NARGS(given) != 1 || names) {
        PyErr_SetString(PyExc_TypeError, "a sender takes one frame");
        return NULL;
    }
    if (args[0] != self->last) {
        uint64_t payload;
        int unusual = payload_of(&self->layout, args[0], &payload);
        if (unusual > 0)
            unusual = python_payload(self, args[0], &payload);
        if (unusual)
            return NULL;
        self->payload = payload;
        Py_XSETREF(self->last, Py_NewRef(args[0]));
    }
    uint8_t data[WIRE_BYTES_MAX], twin[WIRE_BYTES_MAX];
    wire_seal(message, self->payload, ++self->counter, data, twin);
    PyObject *first = half_of(self->id, data, message->length);
    PyObject *second = NULL, *sent = NULL;
    if (first && message->protection != WIRE_VITAL)
        sent = PyTuple_Pack(1, first);
    else if (first && (second = half_of(self->twin_id, twin, message->length)))
        sent = PyTuple_Pack(2, first, second);
    Py_XDECREF(first);
    Py_XDECREF(second);
    return sent;
}

static int sender_traverse(PyObject *object, visitproc visit, void *arg)
{
    Sender *self = (Sender *)object;
    Py_VISIT(self->pack);
    Py_VISIT(self->last);
    return layout_visit(&self->layout, visit, arg);
}

static int sender_clear(PyObject *object)
{
    Sender *self = (Sender *)object;
    Py_CLEAR(self->pack);
    Py_CLEAR(self->last);
    return 0;
}

static void sender_dealloc(PyObject *object)
{
    Sender *self = (Sender *)object;
    PyObject_GC_UnTrack(object);
    sender_clear(object);
    layout_clear(&self->layout);
    Py_CLEAR(self->id);
    Py_CLEAR(self->twin_id);
    Py_TYPE(object)->tp_free(object);
}

static PyTypeObject SenderType = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "wire_codec.Sender",
    .tp_basicsize = sizeof(Sender),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_HAVE_VECTORCALL,
    .tp_vectorcall_offset = offsetof(Sender, call),
    .tp_call = PyVectorcall_Call,
    .tp_traverse = sender_traverse,
    .tp_clear = sender_clear,
    .tp_dealloc = sender_dealloc,
};

static PyObject *make_sender(PyObject *module, PyObject *args)
{
    unsigned int id;
    PyObject *kind, *tables, *pack;
    if (!PyArg_ParseTuple(args, "IO!OO", &id, &PyType_Type, &kind, &tables, &pack))
        return NULL;
    Sender *self = (Sender *)SenderType.tp_alloc(&SenderType, 0);
    if (!self)
        return NULL;
    self->call = sender_call;
    self->counter = 0xFF;
    if (layout_init(&self->layout, id, kind, tables) < 0 || make_natively(&self->layout) < 0 ||
        !(self->id = PyLong_FromLong(id)) ||
        !(self->twin_id = PyLong_FromLong(self->layout.message->twin_id))) {
        Py_DECREF(self);
        return NULL;
    }
    self->pack = Py_NewRef(pack);
    return (PyObject *)self;
}

/* State of the reception of one message; the two halves of a vital one share it. */
typedef struct {
    PyObject_HEAD
    struct layout layout;
    struct wire_receiver state;
    PyObject *refuse; /* Python's function from verdict, twin, data, numbers and bits to a value. */
    PyObject *lost;   /* Python's function that counts lost frames. */
    PyObject *first;  /* Data of the first half that waits. */
    PyObject *frame;  /* The frame of `bits`; None if a value is invalid. */
    uint64_t bits;
} Reception;

static int reception_traverse(PyObject *object, visitproc visit, void *arg)
{
    Reception *self = (Reception *)object;
    Py_VISIT(self->refuse);
    Py_VISIT(self->lost);
    Py_VISIT(self->frame);
    return layout_visit(&self->layout, visit, arg);
}

static int reception_clear(PyObject *object)
{
    Reception *self = (Reception *)object;
    Py_CLEAR(self->refuse);
    Py_CLEAR(self->lost);
    Py_CLEAR(self->frame);
    return 0;
}

static void reception_dealloc(PyObject *object)
{
    Reception *self = (Reception *)object;
    PyObject_GC_UnTrack(object);
    reception_clear(object);
    layout_clear(&self->layout);
    Py_CLEAR(self->first);
    Py_TYPE(object)->tp_free(object);
}

static PyTypeObject ReceptionType = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "wire_codec.Reception",
    .tp_basicsize = sizeof(Reception),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_traverse = reception_traverse,
    .tp_clear = reception_clear,
    .tp_dealloc = reception_dealloc,
};

/* A callable that takes data and instant of one identifier. */
typedef struct {
    PyObject_HEAD
    vectorcallfunc call;
    Reception *reception;
    bool twin;
} Receiver;

static PyObject *refused(const Receiver *self, enum wire_verdict verdict, PyObject *data,
                         long long one, long long other, uint64_t bits)
{
    return PyObject_CallFunction(self->reception->refuse, "iOOLLK", (int)verdict,
                                 self->twin ? Py_True : Py_False, data, one, other,
                                 (unsigned long long)bits);
}

static PyObject *accepted(Receiver *self, PyObject *data, uint64_t bits)
{
    Reception *reception = self->reception;
    if (!reception->frame || bits != reception->bits) {
        PyObject *frame = frame_from(&reception->layout, bits);
        if (!frame)
            return NULL;
        Py_XSETREF(reception->frame, frame);
        reception->bits = bits;
    }
    if (reception->frame != Py_None)
        return Py_NewRef(reception->frame);
    return refused(self, WIRE_INVALID_VALUE, data, 0, 0, bits);
}

static int count_lost(const Reception *reception)
{
    if (!reception->state.lost)
        return 0;
    PyObject *done = PyObject_CallFunction(reception->lost, "i", reception->state.lost);
    Py_XDECREF(done);
    return done ? 0 : -1;
}

static PyObject *receive_first(Receiver *self, PyObject *data, const uint8_t *bytes, size_t length,
                               int64_t at_ns)
{
    Reception *reception = self->reception;
    struct wire_receiver *state = &reception->state;
    uint64_t bits = 0;
    enum wire_verdict verdict =
        wire_check(reception->layout.message, state, bytes, length, at_ns, &bits);
    if (verdict == WIRE_STUCK_COUNTER || verdict == WIRE_JUMPED_COUNTER)
        return refused(self, verdict, data, bytes[length - 3], state->last, 0);
    if (verdict != WIRE_ACCEPTED && verdict != WIRE_FIRST_HALF && verdict != WIRE_ALONE)
        return refused(self, verdict, data, 0, 0, 0);
    if (reception->layout.message->protection != WIRE_NONE && count_lost(reception) < 0)
        return NULL;
    if (verdict == WIRE_ACCEPTED)
        return accepted(self, data, bits);
    PyObject *alone = reception->first;
    reception->first = Py_NewRef(data);
    if (verdict == WIRE_FIRST_HALF) {
        Py_XDECREF(alone);
        Py_RETURN_NONE;
    }
    PyObject *found = refused(self, verdict, alone, 0, 0, 0);
    Py_DECREF(alone);
    return found;
}

static PyObject *receive_twin(Receiver *self, PyObject *data, const uint8_t *bytes, size_t length,
                              int64_t at_ns)
{
    Reception *reception = self->reception;
    uint64_t bits = 0;
    enum wire_verdict verdict = wire_check_twin(reception->layout.message, &reception->state,
                                                  bytes, length, at_ns, &bits);
    if (verdict == WIRE_ACCEPTED)
        return accepted(self, reception->first, bits);
    return refused(self, verdict, data, at_ns, reception->state.first_ns, 0);
}

static PyObject *receiver_call(PyObject *callable, PyObject *const *args, size_t given,
                               PyObject *names)
{
    Receiver *self = (Receiver *)callable;
    if (PyVectorcall_NARGS(given) != 2 || names) {
        PyErr_SetString(PyExc_TypeError, "a receiver takes data and an instant");
        return NULL;
    }
    long long at_ns = PyLong_AsLongLong(args[1]);
    Py_buffer view;
    if ((at_ns == -1 && PyErr_Occurred()) || PyObject_GetBuffer(args[0], &view, PyBUF_SIMPLE) < 0)
        return NULL;
    PyObject *found = (self->twin ? receive_twin : receive_first)(self, args[0], view.buf,
                                                                  (size_t)view.len, at_ns);
    PyBuffer_Release(&view);
    return found;
}

static int receiver_traverse(PyObject *object, visitproc visit, void *arg)
{
    Py_VISIT(((Receiver *)object)->reception);
    return 0;
}

static int receiver_clear(PyObject *object)
{
    Py_CLEAR(((Receiver *)object)->reception);
    return 0;
}

static void receiver_dealloc(PyObject *object)
{
    PyObject_GC_UnTrack(object);
    receiver_clear(object);
    Py_TYPE(object)->tp_free(object);
}

static PyTypeObject ReceiverType = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "wire_codec.Receiver",
    .tp_basicsize = sizeof(Receiver),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_HAVE_VECTORCALL,
    .tp_vectorcall_offset = offsetof(Receiver, call),
    .tp_call = PyVectorcall_Call,
    .tp_traverse = receiver_traverse,
    .tp_clear = receiver_clear,
    .tp_dealloc = receiver_dealloc,
};

static PyObject *new_receiver(Reception *reception, bool twin)
{
    Receiver *self = (Receiver *)ReceiverType.tp_alloc(&ReceiverType, 0);
    if (self) {
        self->call = receiver_call;
        self->reception = (Reception *)Py_NewRef(reception);
        self->twin = twin;
    }
    return (PyObject *)self;
}

static PyObject *make_receivers(PyObject *module, PyObject *args)
{
    unsigned int id;
    long long silence_ns;
    PyObject *kind, *tables, *lost, *refuse, *made = NULL;
    if (!PyArg_ParseTuple(args, "IO!OLOO", &id, &PyType_Type, &kind, &tables, &silence_ns, &lost,
                          &refuse))
        return NULL;
    Reception *self = (Reception *)ReceptionType.tp_alloc(&ReceptionType, 0);
    if (!self)
        return NULL;
    if (layout_init(&self->layout, id, kind, tables) == 0 && make_natively(&self->layout) == 0) {
        self->state.silence_ns = silence_ns;
        self->lost = Py_NewRef(lost);
        self->refuse = Py_NewRef(refuse);
        PyObject *first = new_receiver(self, false), *second = new_receiver(self, true);
        if (first && second)
            made = PyTuple_Pack(2, first, second);
        Py_XDECREF(first);
        Py_XDECREF(second);
    }
    Py_DECREF(self);
    return made;
}

static PyMethodDef methods[] = {
    {"sender", make_sender, METH_VARARGS,
     "sender(id, class, tables, pack): the function from a frame to identifiers and data"},
    {"receivers", make_receivers, METH_VARARGS,
     "receivers(id, class, tables, silence_ns, lost, refuse): those of a frame and of its twin"},
    {NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "codec", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_codec(void)
{
    value_name = PyUnicode_InternFromString("_value_");
    if (!value_name || PyType_Ready(&SenderType) < 0 || PyType_Ready(&ReceptionType) < 0 ||
        PyType_Ready(&ReceiverType) < 0)
        return NULL;
    return PyModule_Create(&definition);
}
