!> Optional columns in tables of responses and branches.
module viscovib_extra_columns
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_column_notes, only: dissipation_note, sampling_note
  use viscovib_kinds, only: wp
  use viscovib_motion_checks, only: losses_of, relative_motions, sampling_of, work_of
  use viscovib_status, only: fail, status_input_error, status_type
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: extra_columns

  type :: extra_columns
    !> True if requested.
    logical :: sampling = .false., dissipation = .false.
    !> Their values, once computed.
    real(wp), allocatable :: errors(:), lost(:)
  contains
    procedure :: check
    procedure :: find
    procedure :: add
  end type extra_columns

contains

  !> Check that the energy loss is available for this subject.
  subroutine check(self, subject, status)
    class(extra_columns), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(status_type), intent(inout) :: status

    if (.not. self%dissipation) return
    if (subject%is_turning) then
      call fail(status, status_input_error, 'dissipation', "dissipation = yes: is not available " &
                //"for a &body with geometry = 'exact', must be no")
    else if (subject%model%supports%pull) then
      call fail(status, status_input_error, 'dissipation', 'dissipation = yes: is not available ' &
                //'with supports that pull at springs or dampers, must be no')
    else if (subject%is_structure) then
      if (subject%model%is_reduced .and. subject%model%load%moves_base()) then
        call fail(status, status_input_error, 'dissipation', 'dissipation = yes: is not ' &
                  //'available for a &structure with shapes on a moving base, must be no')
      end if
    end if
  end subroutine check

  !> Compute the values of all motions.
  subroutine find(self, subject, orders, nu, factor, highest, linear, absolute, found)
    class(extra_columns), intent(inout) :: self
    type(subject_type), intent(in), target :: subject
    integer, intent(in) :: orders(:)
    !> Frequency (rad/s), factor of the load, and highest order kept, of each motion.
    real(wp), intent(in) :: nu(:), factor(:)
    integer, intent(in) :: highest(:)
    !> True if the motions are linear, and if they are absolute (with the base motion).
    logical, intent(in) :: linear, absolute
    !> Harmonics of the unknowns, shape (n_orders, n_dof, n).
    complex(wp), intent(in) :: found(:, :, :)
    complex(wp), allocatable :: motions(:, :, :)

    if (.not. (self%sampling .or. self%dissipation)) return
    allocate (motions, source=found)
    if (absolute) call relative_motions(subject%oscillator(), subject%load, orders, factor, motions)
    if (self%sampling) then
      allocate (self%errors(size(nu)))
      if (linear) then
        self%errors = merge(0.0_wp, ieee_value(0.0_wp, ieee_quiet_nan), highest > 0)
      else
        call sampling_of(subject%oscillator(), subject%load, orders, nu, factor, highest, motions, &
                         self%errors)
      end if
    end if
    if (.not. self%dissipation) return
    allocate (self%lost(size(nu)))
    if (subject%is_structure) then
      call find_fed(subject, orders, nu, factor, highest, linear, motions, self%lost)
    else
      call losses_of(subject%oscillator(), subject%load, orders, nu, factor, highest, linear, &
                     motions, self%lost)
    end if
  end subroutine find

  !> Work of load and base on all coordinates of a structure.
  subroutine find_fed(subject, orders, nu, factor, highest, linear, motions, lost)
    type(subject_type), intent(in) :: subject
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: nu(:), factor(:)
    integer, intent(in) :: highest(:)
    !> True for motions of the forces linearized at zero.
    logical, intent(in) :: linear
    !> Deflections relative to the base.
    complex(wp), intent(in) :: motions(:, :, :)
    real(wp), intent(out) :: lost(:)
    complex(wp), allocatable :: whole(:, :, :), push(:, :)
    real(wp), allocatable :: pulled(:)
    integer :: i, j, k

    associate (load => subject%model%load, n => size(subject%model%base_direction))
      allocate (whole, source=motions)
      call subject%show_motions(nu, factor, orders, [(j, j=1, n)], .false., whole, &
                                linear)
      allocate (push(size(orders), n), pulled(n))
      pulled = 0.0_wp
      if (load%moves_base()) pulled = subject%model%inertia()
      lost = ieee_value(lost, ieee_quiet_nan)
      do i = 1, size(nu)
        if (highest(i) <= 0) cycle
        push = (0.0_wp, 0.0_wp)
        do j = 1, size(load%orders)
          k = findloc(orders, load%orders(j), 1)
          if (k == 0) cycle
          push(k, :) = factor(i)*(load%force_at(j, nu(i)) &
                                  + (orders(k)*nu(i))**2*load%base(j)*pulled)
          whole(k, :, i) = whole(k, :, i) &
                           - factor(i)*load%base(j)*subject%model%base_direction
        end do
        lost(i) = work_of(orders, push, whole(:, :, i))
      end do
    end associate
  end subroutine find_fed

  subroutine add(self, table)
    class(extra_columns), intent(in), target :: self
    type(table_type), intent(inout) :: table
    if (self%sampling) call table%note(sampling_note)
    if (self%dissipation) call table%note(dissipation_note)
    if (self%sampling) call table%hold_reals('sampling', self%errors)
    if (self%dissipation) call table%hold_reals('dissipation', self%lost)
  end subroutine add

end module viscovib_extra_columns
