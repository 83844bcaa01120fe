!> Many motions of a pendulum or a polynomial system without memory, one for each value of a
!! number, eight side by side: last states, peaks, exponents and sections.
module viscovib_many_job
  use viscovib_constants, only: pi
  use viscovib_ensemble, only: ensemble_block, ensemble_job, run_block
  use viscovib_job, only: job_report, job_type, plan_unwanted, table_sink
  use viscovib_kinds, only: i8, wp
  use viscovib_lane_motion, only: lane_motion_type, n_scales, new_lane_motion
  use viscovib_lanes, only: n_lanes
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_polynomial_motion, only: new_polynomial_motion, polynomial_motion_type
  use viscovib_simulate, only: run_completed, run_names
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: many_job

  !> Numbers that vary: of a pendulum, and of a polynomial system (the scales in the order of the
  !! lanes).
  character(len=*), parameter, public :: pendulum_numbers(13) = &
    [character(len=5) :: 'e', 'w2', 'w3', 'alpha', 'c1', 'c2', 'c3', 'f0', 'm01', 'm02', 'p1', &
     'p2', 'p3']
  character(len=*), parameter, public :: system_numbers(5) = &
    [character(len=15) :: 'nu', 'load_scale', 'stiffness_scale', 'damping_scale', 'forces_scale']
  !> Halvings of the step before a tolerance is given up.
  integer, parameter :: most_halvings = 12
  real(wp), parameter :: most_steps = 1.0e10_wp

  type, extends(job_type) :: many_job
    !> What varies and its values; its place among the names.
    character(len=:), allocatable :: vary
    integer :: place = 1
    real(wp), allocatable :: values(:)
    !> One start for all; the frequency of the load of a polynomial system, where it is given.
    real(wp), allocatable :: initial(:)
    real(wp) :: nu = 0.0_wp
    !> Length of the runs, and what is left out before anything is gathered: times, or periods of
    !! load `sections` if that is not 0.
    real(wp) :: t_end = 0.0_wp, discard = 0.0_wp
    integer :: n_periods = 0, sections = 0
    !> Step, 0: found by the tolerance of the last states.
    real(wp) :: dt = 0.0_wp, tolerance = 1.0e-8_wp
    !> Place in `lane_methods`.
    integer :: method = 4
    logical :: lyapunov = .false.
  contains
    procedure, nopass :: kind => this_kind
    procedure :: plan => plan_many
    procedure :: run
  end type many_job

  !> What was learnt, run last.
  type :: many_motions
    real(wp), allocatable :: state(:, :), peak(:, :), mean(:, :), rms(:, :)
    real(wp), allocatable :: lyapunov(:), t_reached(:)
    real(wp), allocatable :: sections(:, :, :)
    integer, allocatable :: ended(:)
  end type many_motions

contains

  pure function this_kind() result(kind)
    character(len=:), allocatable :: kind
    kind = 'ensemble'
  end function this_kind

  subroutine plan_many(self, subject, text, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    call set_ok(status)
    text = 'computes: '//things(size(self%values), 'motion')//', '//self%vary//' = ' &
           //show(self%values(1))//' to '//show(self%values(size(self%values)))//', ' &
           //show(n_lanes)//' side by side'//new_line('a')
    if (self%dt > 0.0_wp) then
      text = text//'skips: estimate of the error (the step is given)'//new_line('a')
    else
      text = text//'computes: the step, halved until the last states change by at most ' &
             //show(self%tolerance)//new_line('a')
    end if
    text = text//'computes: peaks and rms'//new_line('a')
    if (self%sections > 0) then
      text = text//'computes: sections'//new_line('a')
    else
      text = text//'skips: sections (not asked for)'//new_line('a')
    end if
    if (self%lyapunov) then
      text = text//'computes: Lyapunov exponents'//new_line('a')
    else
      text = text//'skips: Lyapunov exponents (not asked for)'//new_line('a')
    end if
    text = text//plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_many

  subroutine run(self, subject, sink, report, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(many_motions) :: coarse, fine
    real(wp) :: spans(size(self%values)), fastest, wanted, change
    integer(i8) :: n
    integer :: i, unit

    call lengths(self, subject, spans, fastest, status)
    if (status%failed()) return
    unit = max(self%n_periods, 1)
    if (self%dt > 0.0_wp) then
      wanted = maxval(spans)/self%dt*(1.0_wp - 1.0e-12_wp)
    else
      wanted = maxval(spans)*fastest/(0.5_wp*pi)
    end if
    if (wanted > most_steps) then
      call fail(status, status_input_error, 'dt', 'dt: takes '//show(wanted) &
                //' steps a motion, must be at most '//show(most_steps))
      return
    end if
    n = unit*max(ceiling(wanted/unit, i8), 1_i8)
    call make_all(self, subject, spans, n, coarse, status)
    change = -1.0_wp
    if (self%dt <= 0.0_wp) then
      do i = 1, most_halvings
        if (status%failed()) return
        call make_all(self, subject, spans, n*2_i8**i, fine, status)
        change = huge(1.0_wp)
        if (all(coarse%ended == fine%ended)) then
          change = max(maxval(abs(fine%state - coarse%state)), &
                       maxval(abs(fine%t_reached - coarse%t_reached)), along(coarse, fine))
        end if
        coarse = fine
        if (change <= self%tolerance) exit
      end do
      n = n*2_i8**min(i, most_halvings)
      if (change > self%tolerance) then
        call fail(status, status_input_error, 'tolerance', 'tolerance = '//show(self%tolerance) &
                  //': not met with '//show(real(n, wp))//' steps; some motion may be chaotic: ' &
                  //'give dt')
      end if
    end if
    if (status%failed()) return
    call put_tables(self, subject, coarse, sink, status)
    report%complete = all(coarse%ended == run_completed)
    report%summary = things(size(self%values), 'motion')//', ' &
                     //show(count(coarse%ended == run_completed))//' completed, ' &
                     //things(int(min(n, int(huge(1), i8))), 'step')//' each'
    if (change >= 0.0_wp) report%summary = report%summary//', estimated error '//show(change)
  end subroutine run

  !> By how much peaks, means and rms of motions that were completed differ at most.
  pure real(wp) function along(coarse, fine)
    type(many_motions), intent(in) :: coarse, fine
    integer :: i
    along = 0.0_wp
    do i = 1, size(fine%ended)
      if (fine%ended(i) /= run_completed) cycle
      along = max(along, maxval(abs(fine%peak(:, i) - coarse%peak(:, i))), &
                  maxval(abs(fine%mean(:, i) - coarse%mean(:, i))), &
                  maxval(abs(fine%rms(:, i) - coarse%rms(:, i))))
    end do
  end function along

  !> How long each run is, and the fastest frequency of all.
  subroutine lengths(self, subject, spans, fastest, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    real(wp), intent(out) :: spans(:), fastest
    type(status_type), intent(out) :: status
    type(pendulum_type) :: pendulum
    type(polynomial_motion_type) :: motion
    real(wp) :: omega(3), shapes(3, 3), frequency
    integer :: i

    call set_ok(status)
    fastest = 0.0_wp
    do i = 1, size(spans)
      if (subject%is_pendulum) then
        call pendulum_of(self, subject, i, pendulum, status)
        if (status%failed()) return
        call pendulum%natural_modes(omega, shapes)
        fastest = max(fastest, maxval(omega), maxval(pendulum%drives))
        frequency = pendulum%parameters%frequency(max(self%sections, 1))
      else
        frequency = merge(self%values(i), self%nu, self%vary == 'nu')
        if (i == 1) then
          call new_polynomial_motion(motion, subject%polynomial, subject%load, 0.0_wp, status)
          if (status%failed()) return
          fastest = motion%fastest()*sqrt(max(1.0_wp, largest_scale(self, 3))) &
                    *max(1.0_wp, largest_scale(self, 4))
        end if
        fastest = max(fastest, frequency*maxval([subject%load%orders, 1]))
      end if
      spans(i) = self%t_end
      if (self%n_periods > 0) then
        if (.not. frequency > 0.0_wp) then
          call fail(status, status_input_error, 'sections', 'sections = '//show(self%sections) &
                    //': the frequency of that load must be greater than 0')
          return
        end if
        spans(i) = self%n_periods*2.0_wp*pi/frequency
      end if
    end do
    if (.not. fastest > 0.0_wp) fastest = pi/maxval(spans)
  end subroutine lengths

  !> The largest value of a scale that varies, else 1.
  pure real(wp) function largest_scale(self, place)
    class(many_job), intent(in) :: self
    integer, intent(in) :: place
    largest_scale = 1.0_wp
    if (self%place == place) largest_scale = maxval(abs(self%values))
  end function largest_scale

  !> Pendulum i.
  subroutine pendulum_of(self, subject, i, pendulum, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    integer, intent(in) :: i
    type(pendulum_type), intent(out) :: pendulum
    type(status_type), intent(out) :: status
    type(pendulum_parameters) :: p

    p = subject%pendulum%parameters
    select case (self%place)
    case (1)
      p%e = self%values(i)
    case (2)
      p%w2 = self%values(i)
    case (3)
      p%w3 = self%values(i)
    case (4)
      p%alpha = self%values(i)
    case (5:7)
      p%damping(self%place - 4) = self%values(i)
    case (8:10)
      p%load(self%place - 7) = self%values(i)
    case default
      p%frequency(self%place - 10) = self%values(i)
    end select
    call new_pendulum(pendulum, p, status)
    if (status%failed()) status%subject = 'from'
  end subroutine pendulum_of

  !> All motions in n steps each.
  subroutine make_all(self, subject, spans, n, many, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    real(wp), intent(in) :: spans(:)
    integer(i8), intent(in) :: n
    type(many_motions), intent(out) :: many
    type(status_type), intent(out) :: status
    type(ensemble_job) :: job
    type(ensemble_block) :: block
    type(lane_motion_type) :: motion
    type(pendulum_type) :: pendulum, other
    real(wp) :: own(size(self%initial)/2, size(self%initial)/2, 2), scales(n_scales), discarded
    integer :: cancel, d, first, i, l, m, n_drives, points

    call set_ok(status)
    m = size(spans)
    d = size(self%initial)/2
    cancel = 0
    points = 0
    n_drives = 2
    if (subject%is_pendulum) n_drives = size(subject%pendulum%drives)
    job%method = self%method
    job%n_steps = n
    job%moments = .true.
    job%n_exponents = merge(1, 0, self%lyapunov)
    allocate (job%lines(0))
    if (self%n_periods > 0) then
      job%section_every = n/self%n_periods
      job%n_discard = nint(self%discard)*job%section_every
      points = self%n_periods - nint(self%discard)
    else
      discarded = self%discard/self%t_end*n
      job%n_discard = ceiling(discarded*(1.0_wp - 1.0e-12_wp), i8)
      job%ahead = max(0.0_wp, job%n_discard - discarded)
    end if
    allocate (many%state(2*d, m), many%peak(2*d, m), many%mean(2*d, m), many%rms(2*d, m))
    allocate (many%lyapunov(m))
    allocate (many%t_reached(m), many%ended(m), many%sections(2*d, points, m))
    if (.not. subject%is_pendulum) then
      own(:, :, 1) = subject%polynomial%stiffness_at_rest()
      own(:, :, 2) = subject%polynomial%damping
      call new_lane_motion(motion, subject%polynomial, subject%load, own)
    end if
    do first = 1, m, n_lanes
      block = ensemble_block()
      allocate (block%q(n_lanes, d), block%v(n_lanes, d))
      allocate (block%frequencies(n_lanes, n_drives))
      allocate (block%sections(n_lanes, 2*d, points), source=0.0_wp)
      do l = 1, n_lanes
        i = min(first + l - 1, m)
        block%q(l, :) = self%initial(1::2)
        block%v(l, :) = self%initial(2::2)
        block%h(l) = spans(i)/n
        if (subject%is_pendulum) then
          call pendulum_of(self, subject, i, other, status)
          if (status%failed()) return
          if (l == 1) pendulum = other
          call pendulum%set_lane(l, other)
          block%frequencies(l, :) = other%drives
        else
          scales = 1.0_wp
          if (self%place > 1) scales(self%place - 1) = self%values(i)
          call motion%set_scales(l, scales)
          block%frequencies(l, :) = merge(self%values(i), self%nu, self%vary == 'nu')
        end if
      end do
      if (subject%is_pendulum) then
        call run_block(job, pendulum, block, cancel)
      else
        call run_block(job, motion, block, cancel)
      end if
      do l = 1, min(n_lanes, m - first + 1)
        call take(block, l, many, first + l - 1)
      end do
    end do
  end subroutine make_all

  !> What a lane has learnt.
  subroutine take(block, l, many, i)
    type(ensemble_block), intent(in) :: block
    integer, intent(in) :: l, i
    type(many_motions), intent(inout) :: many

    many%state(1::2, i) = block%q(l, :)
    many%state(2::2, i) = block%v(l, :)
    many%peak(1::2, i) = block%peak(l, :, 1)
    many%peak(2::2, i) = block%peak(l, :, 2)
    many%mean(1::2, i) = block%mean(l, :, 1)
    many%mean(2::2, i) = block%mean(l, :, 2)
    many%rms(1::2, i) = block%rms(l, :, 1)
    many%rms(2::2, i) = block%rms(l, :, 2)
    many%lyapunov(i) = 0.0_wp
    if (size(block%lyapunov, 2) > 0) many%lyapunov(i) = block%lyapunov(l, 1)
    many%t_reached(i) = block%t_reached(l)
    many%ended(i) = block%outcome(l)
    many%sections(:, :, i) = block%sections(l, :, :)
  end subroutine take

  !> A row for each motion; and one for each point of the sections of motions that were completed.
  subroutine put_tables(self, subject, many, sink, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(many_motions), intent(in), target :: many
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table, points
    character(len=:), allocatable :: name
    integer, allocatable :: whole(:)
    integer :: i, j, k, n

    call table%note('last states, largest sizes and rms of each motion')
    call table%hold_reals(self%vary, self%values)
    call table%add_words('outcome', many%ended, run_names)
    call table%add_reals('t_reached', many%t_reached)
    do i = 1, size(self%wanted)
      j = self%wanted(i)
      name = trim(subject%coordinates(j))
      call table%hold_reals(name, many%state(2*j - 1, :))
      call table%hold_reals(name//'_dot', many%state(2*j, :))
      call table%hold_reals('peak_'//name, many%peak(2*j - 1, :))
      call table%hold_reals('rms_'//name, many%rms(2*j - 1, :))
    end do
    if (self%lyapunov) call table%add_reals('lyapunov', many%lyapunov)
    call sink%put(this_kind(), table, status)
    if (status%failed() .or. self%sections == 0) return
    whole = pack([(i, i=1, size(self%values))], many%ended == run_completed)
    n = size(many%sections, 2)
    call points%note('states at whole periods of load '//show(self%sections) &
                     //', of the motions that were completed')
    call points%hold_reals(self%vary, [(spread(self%values(whole(i)), 1, n), i=1, size(whole))])
    call points%hold_integers('point', [((k, k=1, n), i=1, size(whole))])
    do i = 1, size(self%wanted)
      j = self%wanted(i)
      name = trim(subject%coordinates(j))
      call points%hold_reals(name, pack(many%sections(2*j - 1, :, whole), .true.))
      call points%hold_reals(name//'_dot', pack(many%sections(2*j, :, whole), .true.))
    end do
    call sink%put(this_kind()//'_1', points, status)
  end subroutine put_tables

end module viscovib_many_job
