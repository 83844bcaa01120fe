!> The &branch group of a scene with a pendulum: a branch of driven motions along a
!! frequency or an amplitude of its loads, and others that leave it.
module viscovib_driven_job
  use viscovib_checks, only: check_positive
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, &
    curve_outcomes, follow_curve
  use viscovib_crossings, only: crossing_type
  use viscovib_curve_groups, only: add_stability, check_between, note_crossings, read_curve, &
    read_switch, read_yes, stability_note
  use viscovib_drive_torus, only: default_bound, drive_torus_type, judging_shells, &
    kept_by_symmetry, largest_bound, lattice, lowest_bound, max_unknowns, n_drives, sort_drives, &
    varied_names, varies_nu
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_orbit_stability, only: find_orbit_crossings, judge_orbits, orbit_circle
  use viscovib_outcomes, only: outcome_converged
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_table, only: listed, table_type
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_amplitude, &
    vary_frequency
  use viscovib_torus_orders, only: better_bound, branch_truncation, max_vain, new_ladder, &
    torus_ladder
  use viscovib_torus_response, only: solve_from_rest
  implicit none
  private

  !> Orders are added up to this part of the unknowns that may be asked for.
  real(wp), parameter :: fewer = 2.0_wp

  public :: driven_job, driven_branch, read_driven, plan_driven, run_driven, write_driven

  type :: driven_job
    !> Place in `varied_names`.
    integer :: parameter = 1
    type(curve_options) :: options
    !> Highest order, the first one tried if they are chosen.
    integer :: harmonics = 0
    logical :: choose_harmonics = .true.
    logical :: stability = .true.
    !> Only motions that share the symmetry of system and loads.
    logical :: symmetric = .false.
    integer :: subharmonic = 1, max_denominator = 12
    !> Branch points to leave at, counted from 1, negative: the other way.
    integer, allocatable :: switch(:)
    type(drive_torus_type) :: torus
  end type driven_job

  !> A branch, its values in units of the parameter.
  type :: driven_branch
    integer :: outcome = curve_completed
    !> Highest order kept, and the estimated relative error of leaving out others where it is
    !! largest.
    integer :: harmonics = 0
    real(wp) :: truncation = 0.0_wp
    !> Shape (n); base frequencies, shape (n_axes, n); unknowns, those left out as 0, shape
    !! (torus%n n_dof, n).
    real(wp), allocatable :: parameter(:), base(:, :), x(:, :)
    real(wp), allocatable :: folds(:), branch_points(:)
    !> Largest first, NaN where unknown, shape (6, n), and changes of stability; left without
    !! arrays where not wanted, or with several base frequencies.
    complex(wp), allocatable :: multipliers(:, :)
    type(crossing_type), allocatable :: crossings(:)
  end type driven_branch

contains

  subroutine read_driven(reader, pendulum, job)
    type(group_reader), intent(inout) :: reader
    type(pendulum_type), intent(in) :: pendulum
    type(driven_job), intent(out) :: job
    type(status_type) :: status
    character(len=:), allocatable :: word
    real(wp) :: frequency(n_drives)
    integer :: symmetry, most

    word = reader%read_text('parameter', 'p1', varied_names, job%parameter)
    job%options%start = reader%read_real('from')
    job%options%finish = reader%read_real('to')
    job%subharmonic = reader%read_integer('subharmonic', 1)
    job%max_denominator = reader%read_integer('max_denominator', job%max_denominator)
    if (reader%status%failed()) return
    call check_between(reader, 'subharmonic', job%subharmonic, 1, 20)
    call check_between(reader, 'max_denominator', job%max_denominator, 1, 99)
    if (job%parameter <= n_drives .or. job%parameter == varies_nu) then
      call check_positive('from', job%options%start, status)
      call reader%place(status)
      call check_positive('to', job%options%finish, status)
      call reader%place(status)
    end if
    if (.not. abs(job%options%finish - job%options%start) > 0.0_wp) then
      call reader%complain('to', 'to = '//show(job%options%finish)//': must differ from from')
    end if
    if (reader%status%failed()) return
    frequency = pendulum%parameters%frequency
    if (job%parameter <= n_drives) frequency(job%parameter) = job%options%start
    call sort_drives(job%torus, frequency, pendulum%parameters%load, job%parameter, &
                     job%subharmonic, job%max_denominator, status)
    call reader%place(status)
    if (reader%status%failed()) return
    most = largest_bound(job%torus%n_axes, 1.0_wp, max_unknowns)
    job%harmonics = default_bound(job%torus)
    call reader%read_count('harmonics', job%harmonics, 'auto', job%choose_harmonics)
    call check_between(reader, 'harmonics', job%harmonics, lowest_bound(job%torus), most)
    call read_curve(reader, job%options)
    job%stability = read_yes(reader, 'stability')
    word = reader%read_text('symmetry', 'any', [character(len=4) :: 'any', 'kept'], symmetry)
    job%symmetric = symmetry == 2
    call read_switch(reader, job%switch)
  end subroutine read_driven

  function plan_driven(job) result(text)
    type(driven_job), intent(in) :: job
    character(len=:), allocatable :: text
    text = 'computes: the branch from '//trim(varied_names(job%parameter))//' = ' &
           //show(job%options%start)//' to '//show(job%options%finish)//', '
    if (job%torus%n_axes == 1) then
      text = text//'periodic motions'
    else
      text = text//'quasi-periodic motions of '//show(job%torus%n_axes)//' base frequencies'
    end if
    if (job%choose_harmonics) then
      text = text//', as many orders as the tolerance needs, '//show(job%harmonics)//' at first'
    else
      text = text//', '//show(size(lattice(job%torus%n_axes, job%harmonics), 2)) &
             //' orders a coordinate'
    end if
    text = text//new_line('a')
    if (size(job%switch) > 0) then
      text = text//'computes: '//show(size(job%switch))//' branches that leave it' &
             //new_line('a')
    else
      text = text//'skips: branches that leave it (no switch)'//new_line('a')
    end if
    if (.not. job%stability) then
      text = text//'skips: stability (not wanted)'//new_line('a')
    else if (job%torus%n_axes == 1) then
      text = text//'computes: stability of each motion, and where it changes'//new_line('a')
    else
      text = text//'skips: stability (of quasi-periodic motions, only over a duration, in ' &
             //'Python)'//new_line('a')
    end if
    if (job%symmetric) text = text//'skips: orders that the symmetry of system and loads rules ' &
                              //'out'//new_line('a')
  end function plan_driven

  !> The branch, then those that leave it, in the order asked for.
  subroutine run_driven(job, pendulum, branches, status)
    type(driven_job), intent(in) :: job
    type(pendulum_type), intent(in) :: pendulum
    type(driven_branch), allocatable, intent(out) :: branches(:)
    type(status_type), intent(out) :: status
    type(pendulum_type), target :: system
    type(pendulum_parameters) :: parameters
    type(torus_type) :: torus
    type(torus_balance_type) :: balance
    type(curve_options) :: options
    type(curve_branch_type) :: first, other
    real(wp) :: unit, truncation, last
    integer :: i, n, bound, next, vain, step, most

    allocate (branches(1 + size(job%switch)))
    ! Loads of size 1, their amplitudes apart, as what varies may be one of them.
    parameters = pendulum%parameters
    parameters%load = 1.0_wp
    call new_pendulum(system, parameters, status)
    if (status%failed()) return
    step = judging_shells(job%torus)
    bound = job%harmonics
    most = merge(max(bound, largest_bound(job%torus%n_axes, fewer, max_unknowns)), bound, &
                 job%choose_harmonics)
    last = huge(1.0_wp)
    vain = 0
    do
      call follow_first(bound)
      if (status%failed()) return
      call judge(first, truncation)
      if (status%failed() .or. truncation <= options%tolerance .or. bound >= most) exit
      if (truncation > 0.5_wp*last) vain = vain + 1
      if (vain >= max_vain) exit
      last = truncation
      next = better_bound(bound, truncation, options%tolerance, step, most)
      if (next <= bound) exit
      bound = next
    end do
    if (status%failed()) return
    call keep(first, branches(1))
    branches(1)%truncation = truncation
    do i = 1, size(job%switch)
      n = abs(job%switch(i))
      if (n > first%branch_points%n) then
        call fail(status, status_input_error, 'switch', 'switch = '//show(job%switch(i)) &
                  //': the branch has '//show(first%branch_points%n)//' branch points')
        return
      end if
      associate (points => first%branch_points)
        call follow_curve(balance, options, points%x(:, n), other, points%p(n)*unit/unit, &
                          sign(1, job%switch(i))*points%across(:, n))
      end associate
      call judge(other, truncation)
      if (status%failed()) return
      call keep(other, branches(i + 1))
      branches(i + 1)%truncation = truncation
    end do

  contains

    !> The branch from its beginning, with orders to a bound.
    subroutine follow_first(bound)
      integer, intent(in) :: bound
      real(wp), allocatable :: x(:)
      integer :: outcome, iterations

      call new_torus(torus, lattice(job%torus%n_axes, bound), status)
      if (status%failed()) return
      call new_torus_balance(balance, system, torus, job%torus%orders, job%torus%base, &
                             pendulum%parameters%load, kept_of(torus%orders))
      unit = 1.0_wp
      if (job%parameter > n_drives .and. job%parameter < varies_nu) then
        balance%vary = vary_amplitude
        balance%which = job%parameter - n_drives
      else
        balance%vary = vary_frequency
        balance%which = job%torus%axis
        balance%lowest = 0.0_wp
        unit = real(job%torus%multiple, wp)
      end if
      options = job%options
      options%start = options%start/unit
      options%finish = options%finish/unit
      allocate (x(balance%n))
      iterations = 0
      call solve_from_rest(balance, options%start, options%tolerance, x, outcome, iterations)
      first%n_points = 0
      if (outcome == outcome_converged) call follow_curve(balance, options, x, first)
      if (first%n_points > 0) return
      call fail(status, status_input_error, 'from', trim(varied_names(job%parameter)) &
                //': no solution was found at its beginning '//show(job%options%start) &
                //': begin elsewhere')
    end subroutine follow_first

    !> Which orders of which coordinates are unknowns.
    function kept_of(orders) result(kept)
      integer, intent(in) :: orders(:, :)
      logical :: kept(size(orders, 2), 3)
      kept = .true.
      if (job%symmetric) kept = kept_by_symmetry(job%torus, orders, pendulum%parameters%load, &
                                                 job%parameter)
    end function kept_of

    !> What more orders would change, where that is most.
    subroutine judge(branch, truncation)
      type(curve_branch_type), intent(in) :: branch
      real(wp), intent(out) :: truncation
      type(torus_ladder) :: ladder
      integer, allocatable :: orders(:, :)
      real(wp), allocatable :: x(:, :)
      integer :: k
      truncation = 0.0_wp
      orders = lattice(job%torus%n_axes, bound + step)
      call new_ladder(ladder, system, orders, kept_of(orders), job%torus%orders, job%torus%base, &
                      pendulum%parameters%load, balance%vary, balance%which, bound, bound, step)
      allocate (x(torus%n*3, branch%n_points))
      do k = 1, branch%n_points
        x(:, k) = reshape(balance%expanded(branch%x(:, k)), [torus%n*3])
      end do
      call branch_truncation(ladder, branch%parameter(:branch%n_points), x, options%tolerance, &
                             truncation, status)
    end subroutine judge

    subroutine keep(from, to)
      type(curve_branch_type), intent(in) :: from
      type(driven_branch), intent(out) :: to
      ! Its steps are those of the branch, whatever was computed before.
      type(orbit_floquet_type) :: floquet
      integer :: k
      to%outcome = from%outcome
      to%harmonics = bound
      to%parameter = from%parameter(:from%n_points)*unit
      to%base = spread(job%torus%base, 2, from%n_points)
      if (balance%vary == vary_frequency) to%base(balance%which, :) = from%parameter(:from%n_points)
      allocate (to%x(torus%n*3, from%n_points))
      do k = 1, from%n_points
        to%x(:, k) = reshape(balance%expanded(from%x(:, k)), [torus%n*3])
      end do
      to%folds = from%folds%p*unit
      to%branch_points = from%branch_points%p*unit
      if (.not. job%stability .or. job%torus%n_axes > 1) return
      allocate (to%multipliers(6, from%n_points))
      associate (p => from%parameter(:from%n_points), points => from%x(:, :from%n_points))
        call judge_orbits(floquet, balance, p, points, to%multipliers)
        call find_orbit_crossings(floquet, balance, p, points, &
                                  to%multipliers, from%folds, from%branch_points, to%crossings)
      end associate
      to%crossings%p = to%crossings%p*unit
    end subroutine keep

  end subroutine run_driven

  !> Write the table NAME in a folder, which is made if need be; the table is there
  !! whole or not at all.
  subroutine write_driven(folder, name, job, branch, header, status)
    character(len=*), intent(in) :: folder, name
    type(driven_job), intent(in) :: job
    type(driven_branch), intent(in), target :: branch
    !> Lines for the top, separated by new-line characters.
    character(len=*), intent(in) :: header
    type(status_type), intent(out) :: status
    character(len=*), parameter :: coordinates(3) = [character(len=3) :: 'z', 'phi', 'psi']
    type(table_type) :: table
    integer, allocatable :: orders(:, :)
    character(len=:), allocatable :: varies, title, note
    integer :: i, j, d, k, n

    allocate (orders, source=lattice(job%torus%n_axes, branch%harmonics))
    varies = trim(varied_names(job%parameter))
    n = size(branch%parameter)
    call table%note('branch '//trim(curve_outcomes(branch%outcome))//'; folds at '//varies//' =' &
                    //listed(branch%folds))
    call table%note('branch points at '//varies//' ='//listed(branch%branch_points))
    call table%add_reals(varies, branch%parameter)
    do i = 1, job%torus%n_axes
      call table%add_reals('omega_'//show(i), branch%base(i, :))
    end do
    note = 'q = Im sum_k X_k exp(i k.omega t) of z, phi (rad), psi (rad)'
    if (allocated(branch%multipliers)) then
      call note_crossings(table, branch%crossings, varies)
      note = note//stability_note
      call add_stability(table, [(count_larger(branch%multipliers(:, i), orbit_circle), i=1, n)], &
                         branch%multipliers(1, :))
    end if
    call table%note(note//'; orders to '//show(branch%harmonics)//' leave an estimated relative ' &
                    //'error of '//trim(exact(branch%truncation))//' at most')
    i = 0
    do d = 1, 3
      do k = 1, size(orders, 2)
        title = trim(coordinates(d))//'_'//show(orders(1, k))
        do j = 2, size(orders, 1)
          title = title//','//show(orders(j, k))
        end do
        ! The mean is Im X_0.
        if (k == 1) then
          call table%hold_reals(title//'_re', [(0.0_wp, j=1, n)])
        else
          i = i + 1
          call table%add_reals(title//'_re', branch%x(i, :))
        end if
        i = i + 1
        call table%add_reals(title//'_im', branch%x(i, :))
      end do
    end do
    call table%write(folder, name, header, status)
  end subroutine write_driven

end module viscovib_driven_job
