!> Events that a run is asked for: passages of functions of the state through 0.
module viscovib_watch
  use viscovib_all_passages, only: passage_search
  use viscovib_extremes, only: extremes_type
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: signal_type
  use viscovib_law_functions, only: put_argument, wall
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: watch_type, new_watch, passage_type, coordinates_read, renumbered

  !> Part of its largest value so far within which a signal of a motion that sticks counts as 0.
  real(wp), parameter :: at_rest = 1.0e-11_wp
  !> The least that a signal's largest value is once it had one, be it 0.
  real(wp), parameter :: valued = 2.0_wp**(-1000)

  !> One passage: of which signal, its sign before, the place in the step, and how the signal
  !! changes there, as `passage_search` has it.
  type :: passage_type
    integer :: which = 0, side = 1
    real(wp) :: place = 0.0_wp, rate = 0.0_wp, bend = 0.0_wp
  end type passage_type

  !> Rows of a passage that is handed over besides the state: signal, time, and those two.
  integer, parameter, public :: n_told = 4

  type :: watch_type
    type(signal_type), allocatable :: signals(:)
    !> Coordinates that the signals' states hold; not allocated: all of them.
    integer, allocatable :: reads(:)
    !> Places in parts of steps that are searched, and what makes of a signal there its last
    !! coefficients (`viscovib_march_events`), once they are made.
    type(step_path), allocatable :: path
    real(wp), allocatable :: last(:, :)
    !> Largest values of what signals read in them.
    real(wp), allocatable :: scales(:)
    !> Passages that count: upwards 1, downwards -1, 0 both; whether the run ends there.
    integer, allocatable :: direction(:)
    logical, allocatable :: terminal(:)
    !> On which side of 0 each signal was last, 0: on none yet; its largest value so far, 0: it
    !! had none.
    integer, allocatable :: sides(:)
    real(wp), allocatable :: largest(:)
    !> Signals may change anywhere between places: they are searched by ranges. Of each, in how many
    !! steps some passages may be missing all the same.
    integer, allocatable :: lost(:)
    type(passage_search) :: search
    !> Peaks and means along the motion, if they are asked for.
    type(extremes_type) :: extremes
    !> What was found: signal and time; states, with those of coordinates that are hidden, and
    !! accelerations; rate and bend of the signal. Shapes (n), (2 n_dof, n), (n_dof, n), (2, n).
    integer :: n_found = 0
    integer, allocatable :: which(:)
    real(wp), allocatable :: times(:), states(:, :), accelerations(:, :), changes(:, :)
  contains
    procedure :: is_idle
    procedure :: look
    procedure :: count_of
    procedure :: keep
    procedure :: drop_after
    procedure :: rows
    procedure :: hand_over
  end type watch_type

contains

  !> From numbers: how many; of each, direction, 1 if terminal, how many instructions, and code
  !! and number of each, arguments being the state (q_1, v_1, q_2, ...) and the time; then, if
  !! anything, a time: peaks and means of all coordinates are wanted from then on.
  subroutine new_watch(watch, vector, sides, n_dof)
    type(watch_type), intent(out) :: watch
    real(wp), intent(in) :: vector(:)
    !> Of each, its side, then a power of 2 not above its largest value so far, then how often
    !! passages may be missing; without: a run begins.
    integer, intent(in), optional :: sides(:)
    !> Signals are given the states of those of so many coordinates alone that they read.
    integer, intent(in), optional :: n_dof
    real(wp) :: numbers(size(vector))
    integer :: i, k, m, n

    n = 0
    if (size(vector) > 0) n = nint(vector(1))
    numbers = vector
    k = 1
    do i = 1, n
      k = k + 3 + 2*nint(vector(k + 3))
    end do
    watch%extremes%wanted = size(vector) > k
    if (size(vector) > k) watch%extremes%from = vector(k + 1)
    if (present(n_dof) .and. watch%extremes%wanted) then
      watch%reads = [(i, i=1, n_dof)]
    else if (present(n_dof) .and. n > 0) then
      watch%reads = pack([(i, i=1, n_dof)], coordinates_read(vector, n_dof))
      numbers = renumbered(vector, n_dof, watch%reads)
    end if
    allocate (watch%signals(n), watch%direction(n), watch%terminal(n))
    allocate (watch%largest(n), source=0.0_wp)
    allocate (watch%lost(n), source=0)
    if (present(sides)) then
      watch%sides = sides(:n)
      if (n > 0) watch%lost = sides(2*n + 1:3*n)
      do i = 1, n
        if (any(sides(i:n + i:n) /= 0)) watch%largest(i) = scale(1.0_wp, sides(n + i))
      end do
    else
      allocate (watch%sides(n), source=0)
    end if
    k = 1
    do i = 1, n
      watch%direction(i) = nint(numbers(k + 1))
      watch%terminal(i) = nint(numbers(k + 2)) /= 0
      m = nint(numbers(k + 3))
      watch%signals(i)%program%code = nint(numbers(k + 4:k + 2*m + 3:2))
      watch%signals(i)%program%number = numbers(k + 5:k + 2*m + 3:2)
      call watch%signals(i)%program%measure()
      k = k + 3 + 2*m
    end do
    allocate (watch%which(0), watch%times(0), watch%states(0, 0), watch%accelerations(0, 0))
    allocate (watch%changes(2, 0))
  end subroutine new_watch

  !> Whether nothing is asked for.
  pure logical function is_idle(self)
    class(watch_type), intent(in) :: self
    is_idle = size(self%signals) == 0 .and. .not. self%extremes%wanted
  end function is_idle

  !> Which of n coordinates the signals read, themselves or their velocities.
  pure function coordinates_read(vector, n) result(read_at_all)
    !> As of `new_watch`.
    real(wp), intent(in) :: vector(:)
    integer, intent(in) :: n
    logical :: read_at_all(n)
    integer :: i, k, m, place

    read_at_all = .false.
    k = 1
    do i = 1, nint(vector(1))
      m = nint(vector(k + 3))
      do place = k + 4, k + 2*m + 3, 2
        if (nint(vector(place)) /= put_argument) cycle
        if (nint(vector(place + 1)) <= 2*n) read_at_all((nint(vector(place + 1)) + 1)/2) = .true.
      end do
      k = k + 3 + 2*m
    end do
  end function coordinates_read

  !> The same signals of states that hold only some of n coordinates.
  pure function renumbered(vector, n, places) result(other)
    real(wp), intent(in) :: vector(:)
    integer, intent(in) :: n
    !> Coordinates that are held.
    integer, intent(in) :: places(:)
    real(wp) :: other(size(vector))
    integer :: i, k, m, place, argument

    other = vector
    k = 1
    do i = 1, nint(vector(1))
      m = nint(vector(k + 3))
      do place = k + 4, k + 2*m + 3, 2
        if (nint(vector(place)) /= put_argument) cycle
        argument = nint(vector(place + 1))
        if (argument > 2*n) then
          other(place + 1) = argument - 2*n + 2*size(places)
        else
          other(place + 1) = 2*findloc(places, (argument + 1)/2, 1) - modulo(argument, 2)
        end if
      end do
      k = k + 3 + 2*m
    end do
  end function renumbered

  !> Passages of one signal that were found.
  pure integer function count_of(self, which)
    class(watch_type), intent(in) :: self
    integer, intent(in) :: which
    count_of = count(self%which(:self%n_found) == which)
  end function count_of

  !> Passages in a step that count, ascending; after one that ends the run none.
  subroutine look(self, path, sticks, found)
    class(watch_type), intent(inout) :: self
    type(step_path), intent(in) :: path
    !> Whether the motion sticks to a surface of the system, or comes to one at the end of the step:
    !! what is 0 there, but for rounding, has not passed 0.
    logical, intent(in) :: sticks
    type(passage_type), allocatable, intent(out) :: found(:)
    type(passage_type) :: next
    real(wp) :: g(size(path%points))
    integer :: i, k

    allocate (found(0))
    do i = 1, size(self%signals)
      call self%signals(i)%at(path%start + path%h*path%points, path%q, path%v, g)
      if (any(abs(g) < wall)) then
        self%largest(i) = max(self%largest(i), valued, maxval(abs(g), abs(g) < wall))
      end if
      associate (largest => self%largest(i))
        call self%search%find(self%signals(i), path, merge(at_rest*largest, 0.0_wp, sticks), &
                              largest, self%sides(i))
      end associate
      ! Its only values may lie between places.
      if (self%search%n > 0 .or. self%sides(i) /= 0) then
        self%largest(i) = max(self%largest(i), valued)
      end if
      if (self%search%lost) self%lost(i) = self%lost(i) + 1
      do k = 1, self%search%n
        if (self%direction(i)*self%search%to(k) < 0) cycle
        next%which = i
        next%side = -self%search%to(k)
        next%place = self%search%places(k)
        call self%search%change_at(self%signals(i)%program, path, next%place, next%rate, next%bend)
        call insert(found, next)
      end do
    end do
    do i = 1, size(found)
      if (.not. self%terminal(found(i)%which)) cycle
      found = found(:i)
      return
    end do
  end subroutine look

  subroutine insert(found, next)
    type(passage_type), allocatable, intent(inout) :: found(:)
    type(passage_type), intent(in) :: next
    integer :: n
    n = count(found%place <= next%place)
    found = [found(:n), next, found(n + 1:)]
  end subroutine insert

  !> Remember a passage.
  subroutine keep(self, passage, t, q, v, a)
    class(watch_type), intent(inout) :: self
    type(passage_type), intent(in) :: passage
    !> Time; coordinates, velocities and accelerations.
    real(wp), intent(in) :: t, q(:), v(:), a(:)
    integer, allocatable :: more_which(:)
    real(wp), allocatable :: more_times(:), more_states(:, :), more(:, :), more_changes(:, :)
    integer :: n

    n = self%n_found
    if (n == size(self%which)) then
      allocate (more_which(2*n + 8), more_times(2*n + 8), more_states(2*size(q), 2*n + 8))
      allocate (more(size(q), 2*n + 8), more_changes(2, 2*n + 8))
      if (n > 0) then
        more_which(:n) = self%which
        more_times(:n) = self%times
        more_states(:, :n) = self%states
        more(:, :n) = self%accelerations
        more_changes(:, :n) = self%changes
      end if
      call move_alloc(more_which, self%which)
      call move_alloc(more_times, self%times)
      call move_alloc(more_states, self%states)
      call move_alloc(more, self%accelerations)
      call move_alloc(more_changes, self%changes)
    end if
    n = n + 1
    self%n_found = n
    self%which(n) = passage%which
    self%changes(:, n) = [passage%rate, passage%bend]
    self%accelerations(:, n) = a
    self%times(n) = t
    self%states(1::2, n) = q
    self%states(2::2, n) = v
  end subroutine keep

  !> Forget passages after a time at which the motion turned out to have stopped.
  subroutine drop_after(self, t)
    class(watch_type), intent(inout) :: self
    real(wp), intent(in) :: t
    do while (self%n_found > 0)
      if (self%times(self%n_found) <= t) exit
      self%n_found = self%n_found - 1
    end do
  end subroutine drop_after

  !> What was found, as `passage_errors` takes it: a column each, of the first n coordinates.
  pure function rows(self, n, n_found)
    class(watch_type), intent(in) :: self
    integer, intent(in) :: n, n_found
    real(wp) :: rows(n_told + 3*n, n_found)
    if (n_found == 0) return
    rows(1, :) = self%which(:n_found)
    rows(2, :) = self%times(:n_found)
    rows(3:2*n + 2, :) = self%states(:2*n, :n_found)
    rows(2*n + 3:3*n + 2, :) = self%accelerations(:n, :n_found)
    rows(3*n + 3:, :) = self%changes(:, :n_found)
  end function rows

  !> What was found, as far as there is room; each column the signal, the time and the state of the
  !! first coordinates, their accelerations, and the rate and bend of the signal.
  !! Behind them, in three columns, peaks, integrals and those of squares, if they are asked for.
  subroutine hand_over(self, sides, found, n_found)
    class(watch_type), intent(in) :: self
    integer, intent(inout) :: sides(:)
    real(wp), intent(inout) :: found(:, :)
    !> How many there are, even if there is less room.
    integer, intent(out) :: n_found
    integer :: n, told
    told = 2*((size(found, 1) - n_told)/3)
    n = size(self%sides)
    sides(:n) = self%sides
    sides(n + 1:2*n) = exponent(max(self%largest, tiny(1.0_wp))) - 1
    sides(2*n + 1:3*n) = self%lost
    n_found = self%n_found
    n = min(n_found, size(found, 2))
    if (allocated(self%extremes%peak) .and. n + 3 <= size(found, 2)) then
      found(3:told + 2, n + 1) = self%extremes%peak(:told)
      found(3:told + 2, n + 2) = self%extremes%total(:told)
      found(3:told + 2, n + 3) = self%extremes%squares(:told)
    end if
    found(:, :n) = self%rows(told/2, n)
  end subroutine hand_over

end module viscovib_watch
