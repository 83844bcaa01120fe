!> Condensation of a polynomial system whose forces act in few of its coordinates to a structure.
module viscovib_condensed_subject
  use viscovib_cycle_terms, only: has_kinks
  use viscovib_load, only: load_type
  use viscovib_polynomial_condensation, only: condense_polynomial, condenses
  use viscovib_status, only: status_type
  use viscovib_structure_model, only: put_load
  use viscovib_subject, only: subject_type
  implicit none
  private

  public :: condense_in_time, condense_subject

contains

  !> Condense a subject if this makes motions, and their stability if requested, faster.
  subroutine condense_subject(subject, stability)
    type(subject_type), intent(inout) :: subject
    logical, intent(in) :: stability
    if (.not. subject%is_polynomial .or. subject%is_structure) return
    ! Stability between kinks is as fast in all coordinates, but the balance has many harmonics.
    if (condenses(subject%polynomial, stability .and. .not. has_kinks(subject%polynomial))) then
      call condense(subject, .false.)
    end if
  end subroutine condense_subject

  !> The same for motions in time, whose modes are exact in each step.
  subroutine condense_in_time(subject)
    type(subject_type), intent(inout) :: subject
    call condense(subject, .true.)
  end subroutine condense_in_time

  !> Convert a polynomial system to a structure, unless its modes do not give the compliance.
  subroutine condense(subject, in_time)
    type(subject_type), intent(inout) :: subject
    logical, intent(in) :: in_time
    type(load_type) :: load
    type(status_type) :: status

    load = subject%load
    call condense_polynomial(subject%polynomial, subject%model, subject%structure, status)
    if (.not. status%failed()) then
      call put_load(subject%model, load, in_time, subject%structure, subject%load, status)
    end if
    if (status%failed()) then
      subject%load = load
      return
    end if
    subject%is_polynomial = .false.
    subject%is_structure = .true.
  end subroutine condense

end module viscovib_condensed_subject
