-------------------------------- MODULE line --------------------------------
(* Trains that command themselves: lease, fence, roster, authority, object and border.
   docs/design/t2t_model.md explains this model. Two areas are one track of five cells: area 1 has
   the cells 1 to 3, area 2 the cells 4 and 5. The object stands in cell 4. A train fills one cell.
   Messages may be lost, late, repeated and out of order, and each node may be late with everything.
   `Holds` names each guard as the code does; TLC must find a fault when any one is removed.        *)
EXTENDS Integers, FiniteSets, Sequences

CONSTANTS Trains,      \* 1 .. 3; at the start a train of a higher number is farther ahead
          Arbiters, Candidates,  \* by area, the trains that may ask for its lease
          MaxTerm,     \* by area, the last term
          MaxAir,      \* by area, authorities on their way to one train
          MaxVersion,  \* versions of a roster under one term
          MaxNonce,    \* claims of one master
          MaxFaults,   \* restarts and losses of memory, by kind
          Switches,    \* whether masters name successors
          Warm,        \* areas in which a master commands from the start
          Removed      \* names of the guards that are taken away

Areas == {1, 2}
Border == 3
Object == 4
AreaEnd == <<Border, 5>>
Majority == Cardinality(Arbiters) \div 2 + 1
Holds(guard, condition) == guard \in Removed \/ condition
Max(set) == CHOOSE x \in set : \A y \in set : y <= x
Min(set) == CHOOSE x \in set : \A y \in set : x <= y
Range(list) == {list[i] : i \in DOMAIN list}
Newer(term, version, thanTerm, thanVersion) == term > thanTerm \/ (term = thanTerm /\ version > thanVersion)

VARIABLES pos,     \* by train, the true cell
          reach,   \* by train, the last cell that it can still come to
          train,   \* by train, its memory and the authorities that it holds
          air,     \* by train and area, the authorities sent to it, in the order of sending
          arb,     \* by arbiter and area, its memory, and whether the lease has not yet run out there
          cmd,     \* by train and area, what it knows as candidate or master
          object,  \* its state, and the claim that it obeyed last
          claims,  \* all claims ever sent
          beats,   \* by area, the terms in which a heartbeat was ever sent
          won,     \* every command: area, term, train and incarnation of the train
          faults   \* faults that may still happen, by kind
NoAuthority == [end |-> 0, behind |-> 0]
Unknown == [rear |-> 0, reserved |-> 0, boot |-> 0, behind |-> 0]
Nothing == [state |-> "none", term |-> 0, runs |-> FALSE, votes |-> {}, over |-> {}, from |-> 0,
            version |-> 0, list |-> <<>>, acks |-> {}, kept |-> <<>>, known |-> [u \in Trains |-> Unknown],
            nonce |-> 0, locked |-> FALSE]
Fresh == [ok |-> TRUE, boot |-> 1, seen |-> <<0, 0>>, tried |-> <<0, 0>>, auth |-> <<NoAuthority, NoAuthority>>]
Unlet == [term |-> 0, holder |-> 0, successor |-> 0, over |-> 0, busy |-> FALSE,
          rterm |-> 0, rversion |-> 0, list |-> <<>>]
Order == [i \in 1 .. Cardinality(Trains) |-> Max(Trains) + 1 - i]
\* Where an area is warm, the run begins with a master: the foremost train, or the last one if no train may follow it.
First(a) == IF Candidates[a] = {} THEN Min(Trains) ELSE Max(Trains)
Begun(a) == IF a \in Warm THEN 1 ELSE 0
List(a) == IF a = 1 THEN Order ELSE IF 2 \in Warm THEN <<Max(Trains)>> ELSE <<>>
Lease(a) == [Unlet EXCEPT !.term = Begun(a), !.rterm = Begun(a), !.rversion = Begun(a), !.list = List(a),
                          !.holder = IF a \in Warm THEN First(a) ELSE 0, !.busy = a \in Warm]
Master(a) == [Nothing EXCEPT !.state = "master", !.term = 1, !.runs = TRUE, !.votes = Arbiters, !.version = 1,
    !.list = List(a), !.kept = List(a), !.acks = Arbiters, !.nonce = a - 1, !.locked = a = 2,
    !.known = [u \in Trains |-> IF u \notin Range(List(a)) THEN Unknown
               ELSE [rear |-> u, reserved |-> IF a = 1 THEN 0 ELSE u, boot |-> 1, behind |-> 0]]]
Init == /\ pos = [u \in Trains |-> u] /\ reach = pos
        /\ train = [u \in Trains |-> [Fresh EXCEPT
              !.seen = <<Begun(1), Begun(2)>>, !.tried = <<Begun(1), Begun(2)>>,
              !.auth[1].end = IF 1 \in Warm /\ u = Border THEN Border ELSE 0]]
        /\ air = [u \in Trains |-> <<<<>>, <<>>>>]
        /\ arb = [b \in Arbiters |-> [ok |-> TRUE, lease |-> [a \in Areas |-> Lease(a)]]]
        /\ cmd = [t \in Trains |-> [a \in Areas |-> IF a \in Warm /\ t = First(a) THEN Master(a) ELSE Nothing]]
        /\ object = [locked |-> TRUE, term |-> Begun(2), nonce |-> Begun(2)]
        /\ claims = {} /\ beats = [a \in Areas |-> IF a \in Warm THEN {1} ELSE {}]
        /\ won = {<<a, 1, First(a), 1>> : a \in Warm} /\ faults = MaxFaults
Command(t, a, states) == train[t].ok /\ cmd[t][a].state \in states
Commands(t, a) == Command(t, a, {"master"})

(* Lease: candidate and arbiters ***********************************************************************)
Ask(t, a) ==
    LET self == train[t]
        term == Max({self.seen[a]} \cup (IF "unused_term" \in Removed THEN {} ELSE {self.tried[a]})) + 1
    IN /\ Command(t, a, {"none"}) /\ t \in Candidates[a] /\ term <= MaxTerm[a]
       /\ train' = [train EXCEPT ![t].tried[a] = term]
       /\ cmd' = [cmd EXCEPT ![t][a] = [Nothing EXCEPT !.state = "asked", !.term = term, !.runs = TRUE]]
       /\ UNCHANGED <<pos, reach, air, arb, object, claims, beats, won, faults>>
\* A candidate adopts the newest roster among those of the arbiters that granted its request.
Vote(b, asked, lease) ==
    LET adopts == asked.votes = {} \/ Newer(lease.rterm, lease.rversion, asked.from, asked.version)
        votes == [asked EXCEPT !.votes = @ \cup {b}, !.over = @ \cup ({lease.over} \ {0})]
    IN IF adopts THEN [votes EXCEPT !.from = lease.rterm, !.version = lease.rversion, !.list = lease.list] ELSE votes
Grant(b, t, a) ==
    LET old == arb[b].lease[a]  asked == cmd[t][a]
        lease == [old EXCEPT !.term = asked.term, !.holder = t, !.successor = 0, !.busy = TRUE,
                             !.over = IF old.busy /\ old.successor = t THEN old.holder ELSE 0]
    IN /\ Command(t, a, {"asked"}) /\ arb[b].ok /\ b \notin asked.votes
       /\ Holds("term_is_new", asked.term > old.term)
       /\ Holds("lease_is_free", ~old.busy \/ t \in {old.successor, old.holder})
       /\ arb' = [arb EXCEPT ![b].lease[a] = lease]
       /\ cmd' = [cmd EXCEPT ![t][a] = Vote(b, asked, lease)]
       /\ UNCHANGED <<pos, reach, train, air, object, claims, beats, won, faults>>
Late(b, t, a) ==        \* The answer to an earlier request comes late.
    LET lease == arb[b].lease[a]  asked == cmd[t][a]
    IN /\ Command(t, a, {"asked"}) /\ b \notin asked.votes /\ lease.holder = t
       /\ Holds("answers_this_attempt", lease.term = asked.term)
       /\ cmd' = [cmd EXCEPT ![t][a] = Vote(b, asked, lease)]
       /\ UNCHANGED <<pos, reach, train, air, arb, object, claims, beats, won, faults>>
\* A master acts only on a roster that a majority of the arbiters has stored.
Relies(self) == IF Holds("roster_kept", Cardinality(self.acks) >= Majority)
                THEN [self EXCEPT !.state = "master", !.kept = self.list] ELSE self
Lead(t, a) ==
    LET self == [cmd[t][a] EXCEPT !.state = "fencing", !.version = 1, !.from = 0]
    IN /\ Command(t, a, {"asked"}) /\ cmd[t][a].votes # {}
       /\ Holds("granted_by_majority", Cardinality(cmd[t][a].votes) >= Majority)
       /\ cmd' = [cmd EXCEPT ![t][a] = Relies(self)]
       /\ beats' = [beats EXCEPT ![a] = @ \cup {cmd[t][a].term}]
       /\ won' = won \cup {<<a, cmd[t][a].term, t, train[t].boot>>}
       /\ UNCHANGED <<pos, reach, train, air, arb, object, claims, faults>>
Name(t, a, u) ==
    /\ Switches /\ Commands(t, a) /\ u # t /\ u \in Candidates[a] /\ cmd[t][a].known[u].rear > 0
    /\ \E b \in Arbiters :
         /\ arb[b].ok /\ arb[b].lease[a].holder = t /\ arb[b].lease[a].term = cmd[t][a].term
         /\ arb[b].lease[a].successor # u /\ arb' = [arb EXCEPT ![b].lease[a].successor = u]
    /\ UNCHANGED <<pos, reach, train, air, cmd, object, claims, beats, won, faults>>
LeaseEnds(t, a) ==      \* A holder looks at its clock before it sends, so it sends nothing any more.
    /\ cmd[t][a].runs /\ Candidates[a] # {}     \* An area without candidates keeps its master.
    /\ cmd' = [cmd EXCEPT ![t][a] = IF "lease_runs" \in Removed /\ cmd[t][a].state = "master"
                                    THEN [@ EXCEPT !.runs = FALSE] ELSE Nothing]
    /\ UNCHANGED <<pos, reach, train, air, arb, object, claims, beats, won, faults>>
Lapse(b, a) ==          \* The lease ends at the arbiter, after it has ended at whom it was granted to.
    LET counts(t) == \/ b \in cmd[t][a].votes
                     \/ arb[b].lease[a].holder = t /\ arb[b].lease[a].term = cmd[t][a].term
    IN /\ arb[b].ok /\ arb[b].lease[a].busy
       /\ Holds("granted_until_ns", ~\E t \in Trains : cmd[t][a].runs /\ counts(t))
       /\ arb' = [arb EXCEPT ![b].lease[a].busy = FALSE]
       /\ UNCHANGED <<pos, reach, train, air, cmd, object, claims, beats, won, faults>>

(* Roster ************************************************************************************************)
Keep(b, t, a) ==
    LET lease == arb[b].lease[a]  self == cmd[t][a]
    IN /\ Command(t, a, {"fencing", "master"}) /\ arb[b].ok /\ b \notin self.acks
       /\ ~Newer(lease.rterm, lease.rversion, self.term, self.version)
       /\ Holds("by_holder", lease.holder = t /\ lease.term = self.term)
       /\ arb' = [arb EXCEPT ![b].lease[a] = [lease EXCEPT
              !.rterm = self.term, !.rversion = self.version, !.list = self.list]]
       /\ cmd' = [cmd EXCEPT ![t][a] = Relies([self EXCEPT !.acks = @ \cup {b}])]
       /\ UNCHANGED <<pos, reach, train, air, object, claims, beats, won, faults>>
Propose(t, a, list) ==
    /\ Commands(t, a) /\ cmd[t][a].kept = cmd[t][a].list /\ cmd[t][a].version < MaxVersion
    /\ cmd' = [cmd EXCEPT ![t][a] = Relies([@ EXCEPT !.list = list, !.version = @ + 1, !.acks = {}])]
    /\ UNCHANGED <<pos, reach, train, air, arb, object, claims, beats, won, faults>>
Admit(t, u) ==          \* A train that comes over the border follows the last one of area 2.
    LET list == cmd[t][2].list  known == cmd[t][2].known[u]
        last == IF list = <<>> THEN 0 ELSE list[Len(list)]
    IN /\ u \notin Range(list) /\ known.rear > 0
       /\ Holds("comes_in_line", known.behind \in {0, last})
       /\ Propose(t, 2, Append(list, u))
Depart(t, u) ==         \* A train leaves area 1 when its rear is beyond the border.
    /\ u \in Range(cmd[t][1].list) /\ cmd[t][1].known[u].rear > 0
    /\ Holds("left_area", cmd[t][1].known[u].rear > Border)
    /\ Propose(t, 1, SelectSeq(cmd[t][1].list, LAMBDA v : v # u))

(* Fence and authority *********************************************************************************)
Obeys(self, a, m) == /\ Holds("for_this_incarnation", m.boot = self.boot)
                     /\ Holds("member.term_not_old", m.term >= self.seen[a])
\* Messages that a train will refuse for ever do not count as on their way.
Live(list, self, a) == SelectSeq(list, LAMBDA m : Obeys(self, a, m))
\* How far a train may go. At the border both areas must have their say.
Allowed(p, auth) ==
    IF p > Border THEN auth[2].end
    ELSE IF auth[1].end < Border THEN auth[1].end
    ELSE IF "ends_at_border" \in Removed THEN auth[1].end ELSE Max({Border, auth[2].end})
\* A train takes part in area 2 from some distance before the border.
Concerned(u, a) == a = 1 \/ pos[u] >= Border - 1
Hear(u, a) ==           \* A heartbeat, which may be old.
    \E term \in beats[a] :
       /\ train[u].ok /\ Concerned(u, a) /\ term > train[u].seen[a]
       /\ train' = [train EXCEPT ![u].seen[a] = term]
       /\ air' = [air EXCEPT ![u][a] = Live(@, train'[u], a)]
       /\ UNCHANGED <<pos, reach, arb, cmd, object, claims, beats, won, faults>>
Report(u, t, a) ==
    LET self == train[u]
        coming == {air[u][a][i].end : i \in {j \in DOMAIN air[u][a] : air[u][a][j].term = cmd[t][a].term /\ ~air[u][a][j].passed
                                                                /\ air[u][a][j].boot = self.boot}}
        holds == IF "latent_authority_m" \in Removed THEN Allowed(pos[u], self.auth) ELSE Max({reach[u], self.auth[a].end})
        behind == IF self.auth[1].end = 0 /\ pos[u] <= Border THEN -1 ELSE self.auth[1].behind
        \* What the master of an area has no use for is left out: fewer states.
        known == IF a = 1 THEN [Unknown EXCEPT !.rear = Min({pos[u], Border + 1}), !.boot = self.boot]
                 ELSE [rear |-> Max({pos[u], Border}), boot |-> self.boot,
                       reserved |-> Max({holds, Border} \cup coming),
                       behind |-> IF u \in Range(cmd[t][2].list) THEN 0 ELSE behind]
    IN /\ Command(t, a, {"fencing", "master"}) /\ self.ok /\ cmd[t][a].known[u] # known
       /\ Concerned(u, a) /\ MaxAir[a] > 0 /\ (u \in Range(cmd[t][a].list) \/ MaxVersion > 1)
       /\ Holds("has_promised", self.seen[a] = cmd[t][a].term)
       /\ cmd' = [cmd EXCEPT ![t][a].known[u] = known]
       /\ UNCHANGED <<pos, reach, train, air, arb, object, claims, beats, won, faults>>
Issue(t, a, u) ==
    LET self == cmd[t][a]
        ahead == {i \in DOMAIN self.list : i < Len(self.list) /\ self.list[i + 1] = u}
        behind == IF ahead = {} THEN 0 ELSE self.list[Max(ahead)]
        rear == self.known[u].rear
        bounds == {IF "ends_at_border" \in Removed THEN AreaEnd[2] ELSE AreaEnd[a]}
            \cup (IF behind = 0 \/ "ends_behind_rear" \in Removed THEN {} ELSE {self.known[behind].rear - 1})
            \cup (IF a = 2 /\ rear <= Object /\ ~self.locked THEN {Object - 1} ELSE {})
        sent == air[u][a]
        newest == IF sent = <<>> THEN train[u].auth[a].end ELSE sent[Len(sent)].end
    IN /\ Commands(t, a) /\ u \in Range(self.list) \cap Range(self.kept) /\ rear > 0
       /\ behind # 0 => self.known[behind].rear > 0
       /\ Len(sent) < MaxAir[a]
       /\ \E end \in {Min(bounds)} \cup (IF a = 2 THEN {Border} ELSE {}) :  \* in full, or short of the object
            /\ end # newest /\ (a = 2 => end >= Border)
            /\ air' = [air EXCEPT ![u][a] = Live(Append(sent,
                 [term |-> self.term, boot |-> self.known[u].boot, end |-> end, behind |-> behind,
                  passed |-> FALSE]), train[u], a)]
            /\ cmd' = [cmd EXCEPT ![t][a].known[u].reserved = IF a = 1 THEN 0 ELSE Max({@, end})]
       /\ UNCHANGED <<pos, reach, train, arb, object, claims, beats, won, faults>>
Accept(u, a, i) ==      \* What was sent before comes too late afterwards.
    LET m == air[u][a][i]
        auth == [train[u].auth EXCEPT ![a] = [end |-> m.end, behind |-> m.behind]]
        passed == [j \in 1 .. i - 1 |-> [air[u][a][j] EXCEPT !.passed = TRUE]]
        rest == IF "newer_than_held" \in Removed THEN passed ELSE <<>>
    IN /\ train[u].ok /\ Obeys(train[u], a, m)
       /\ train' = [train EXCEPT ![u].auth = auth, ![u].seen[a] = Max({@, m.term})]
       /\ air' = [air EXCEPT ![u][a] = Live(rest \o SubSeq(@, i + 1, Len(@)), train'[u], a)]
       /\ reach' = [reach EXCEPT ![u] = Max({@, Allowed(pos[u], auth)})]
       /\ UNCHANGED <<pos, arb, cmd, object, claims, beats, won, faults>>
Stop(u) ==              \* A train has stopped for a shorter authority, or because it holds none.
    LET still == Max({pos[u], Allowed(pos[u], train[u].auth)})
    IN /\ reach[u] > still /\ reach' = [reach EXCEPT ![u] = still]
       /\ UNCHANGED <<pos, train, air, arb, cmd, object, claims, beats, won, faults>>
Move(u) ==
    /\ pos[u] < reach[u] /\ pos' = [pos EXCEPT ![u] = @ + 1]
    /\ UNCHANGED <<reach, train, air, arb, cmd, object, claims, beats, won, faults>>

(* Object *************************************************************************************************)
Claim(t, locks) ==
    LET self == cmd[t][2]
        passes(u) == self.known[u].rear > 0
                     /\ (self.known[u].rear > Object \/ self.known[u].reserved < Object)
    IN /\ Commands(t, 2) /\ self.nonce < MaxNonce
       /\ locks \/ Holds("cannot_reach", \A u \in Range(self.list) \cup Range(self.kept) : passes(u))
       /\ claims' = claims \cup {[term |-> self.term, nonce |-> self.nonce + 1, locks |-> locks]}
       /\ cmd' = [cmd EXCEPT ![t][2].nonce = @ + 1, ![t][2].locked = FALSE]
       /\ UNCHANGED <<pos, reach, train, air, arb, object, beats, won, faults>>
Obey(c) ==
    /\ Holds("object.term_not_old", c.term >= object.term)
    /\ Holds("newer_claim", c.term = object.term => c.nonce > object.nonce)
    /\ object' = [locked |-> c.locks, term |-> c.term, nonce |-> c.nonce] /\ object' # object
    /\ UNCHANGED <<pos, reach, train, air, arb, cmd, claims, beats, won, faults>>
Confirm(t) ==
    /\ Commands(t, 2) /\ ~cmd[t][2].locked /\ object.locked
    /\ Holds("object_confirmed", object.term = cmd[t][2].term /\ object.nonce = cmd[t][2].nonce)
    /\ cmd' = [cmd EXCEPT ![t][2].locked = TRUE]
    /\ UNCHANGED <<pos, reach, train, air, arb, object, claims, beats, won, faults>>

(* Faults *************************************************************************************************)
Spend(kind) == faults[kind] > 0 /\ faults' = [faults EXCEPT ![kind] = @ - 1]
\* A node without its memory takes no part any more.
Restart(u, forgets) ==
    LET old == train[u]
        self == IF forgets THEN [Fresh EXCEPT !.ok = "memory" \in Removed]
                ELSE [Fresh EXCEPT !.ok = old.ok, !.boot = old.boot + 1, !.seen = old.seen, !.tried = old.tried]
    IN /\ Spend(IF forgets THEN "train forgets" ELSE "train restarts")
       /\ train' = [train EXCEPT ![u] = self] /\ cmd' = [cmd EXCEPT ![u] = <<Nothing, Nothing>>]
       /\ air' = [air EXCEPT ![u] = [a \in Areas |-> Live(@[a], self, a)]]
       /\ UNCHANGED <<pos, reach, arb, object, claims, beats, won>>
RestartArbiter(b, forgets) ==
    LET busy(a) == "waits_after_start" \notin Removed /\ arb[b].lease[a].term > 0
        lease(a) == [(IF forgets THEN Unlet ELSE arb[b].lease[a]) EXCEPT !.busy = busy(a)]
    IN /\ Spend(IF forgets THEN "arbiter forgets" ELSE "arbiter restarts")
       /\ arb' = [arb EXCEPT ![b] = [ok |-> @.ok /\ (forgets => "arbiter.memory" \in Removed),
                                     lease |-> [a \in Areas |-> lease(a)]]]
       /\ UNCHANGED <<pos, reach, train, air, cmd, object, claims, beats, won>>
Next == \/ \E t \in Trains, a \in Areas :
             \/ Ask(t, a) \/ Lead(t, a) \/ LeaseEnds(t, a) \/ Hear(t, a)
             \/ \E b \in Arbiters : Grant(b, t, a) \/ Late(b, t, a) \/ Keep(b, t, a)
             \/ \E u \in Trains : Name(t, a, u) \/ Report(u, t, a) \/ Issue(t, a, u)
             \/ \E i \in DOMAIN air[t][a] : Accept(t, a, i)
        \/ \E t, u \in Trains : Admit(t, u) \/ Depart(t, u)
        \/ \E t \in Trains : Stop(t) \/ Move(t) \/ Claim(t, TRUE) \/ Claim(t, FALSE) \/ Confirm(t)
        \/ \E c \in claims : Obey(c)
        \/ \E b \in Arbiters, a \in Areas : Lapse(b, a)
        \/ \E u \in Trains, forgets \in BOOLEAN : Restart(u, forgets)
        \/ \E b \in Arbiters, forgets \in BOOLEAN : RestartArbiter(b, forgets)
Spec == Init /\ [][Next]_<<pos, reach, train, air, arb, cmd, object, claims, beats, won, faults>>

(* Invariants *********************************************************************************************)
\* A term of an area belongs to one train, in one incarnation.
OneOwner == \A x, y \in won : (x[1] = y[1] /\ x[2] = y[2]) => x = y
\* At most one master commands an area, apart from one and the successor that it named.
OneMaster == \A a \in Areas, t, u \in Trains :
    (t # u /\ Commands(t, a) /\ Commands(u, a)) => (t \in cmd[u][a].over \/ u \in cmd[t][a].over)
\* No two trains can come to the same cell.
Apart == \A u, v \in Trains : pos[u] < pos[v] => reach[u] < pos[v]
\* No authority that a train holds or may still accept reaches the true rear of a train ahead.
\* In area 2 an authority up to the border gives nothing.
TrueRear == \A u, v \in Trains, a \in Areas : pos[u] < pos[v] =>
    LET ends == {m.end : m \in {n \in Range(air[u][a]) : Obeys(train[u], a, n)}} \cup {train[u].auth[a].end}
    IN \A end \in ends : end < pos[v] \/ (a = 2 /\ end <= Border)
\* A train that can come beyond the border is on the roster that a majority committed there.
OverBorder == \A u \in Trains : reach[u] > Border =>
    Cardinality({b \in Arbiters : ~arb[b].ok \/ u \in Range(arb[b].lease[2].list)}) >= Majority
\* No train stands on an object that is free to move, or can come to it.
ObjectLocked == object.locked \/ \A u \in Trains : pos[u] > Object \/ reach[u] < Object
=============================================================================
